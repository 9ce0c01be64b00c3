// What must vent the bench, at random moments: each trial arms anew, and measures from the cause
// to the words that vent.
import { Board, Reset } from "./board.mjs";
import { figures, randomNumbers, rounded } from "./figures.mjs";
import { Host } from "./host.mjs";

const SCHEMES = ["two", "duty_in", "duty", "slide", "ram", "pwm", "burst", "open"];
const REQUESTS = [
  "stat",
  "conf",
  "conf 7",
  "get trip",
  "faults",
  "help",
  "timing",
  "telemetry 10",
  "led sync 77 20",
  "sp 20000",
  "frobnicate",
];
const OVER = 3000;
const TRIP_N = 3; // with the default configuration, as the limit below 3000
const PRESSURE = 320; // a fall to 0 from less is not faster than a vent
const MS = 1e6;

class Bench {
  constructor(job, tell) {
    this.job = job;
    this.tell = tell;
    this.board = new Board(job);
    this.host = new Host(this.board, job.guarded);
    this.random = randomNumbers(job.seed + 1);
    this.host.boot();
    this.state = this.board.findState(job);
    this.words = []; // [ns, machine, word, the core has latched a fault]
    this.readings = []; // times of conversions
    this.steps = [];
    this.board.onWord = (machine, word) => {
      this.words.push([this.board.nanos, machine, word, this.state(job.places.FAULTS) !== 0]);
    };
    this.board.onConversion = () => this.readings.push(this.board.nanos);
    this.board.onStep = (start, end) => this.steps.push((end - start) / 1000);
  }

  pick(list) {
    return list[Math.floor(this.random() * list.length)];
  }

  /** Arm and start a scheme, after the fault of the trial before. */
  prepare(number) {
    const { board, host } = this;
    this.scheme = SCHEMES[number % SCHEMES.length];
    board.forced = -1;
    board.frozen = false;
    board.chamber.reset();
    host.wait(8); // readings below the limits again
    host.must("clear");
    host.arm();
    host.start(this.scheme);
    host.wait(20 + 40 * this.random());
    host.beat();
    host.wait(100 * this.random() ** 2);
  }

  /** Forget what was seen before the cause. */
  mark() {
    this.words.length = this.readings.length = 0;
    this.seen = this.host.events.length;
    return this.board.nanos;
  }

  /** The cause in the fault event, or null. */
  cause() {
    const fault = this.host.events.slice(this.seen).find((event) => event[1].startsWith("fault"));
    return fault ? fault[1].match(/cause=(\w+)/)[1] : null;
  }

  /** Causes that the core has latched, as bits; whether they were reported or not. */
  faultsLatched() {
    return this.state(this.job.places.FAULTS);
  }

  /** Wait for the fault event, then a little longer: the vent must last. */
  settle(ms) {
    this.host.wait(ms, () => this.cause() !== null);
    this.host.wait(5);
  }

  /**
   * When the core commands the vent: the later of both valves' first words after it has latched a
   * fault (a scheme may have been venting before). Null if it never does, or not for good.
   */
  ventAt() {
    const words = this.words.filter((word) => word[3]);
    if (words.some((word) => word[2] !== 0)) return null;
    const first = [0, 1].map((machine) => words.find((word) => word[1] === machine));
    return first[0] && first[1] ? Math.max(first[0][0], first[1][0]) : null;
  }
}

const ms = (ns) => (ns === null ? null : rounded(ns / 1e6, 4));

/** Over-pressure, with something else going on at the same time. */
function over(bench) {
  const { board, host, random } = bench;
  let other = "";
  if (random() < 0.7) {
    other = random() < 0.3 ? "hb" : bench.pick(REQUESTS);
    if (other === "hb") host.beat();
    else host.send(other);
    host.wait(12 * random());
  }
  host.wait(random());
  const from = bench.mark();
  board.forced = OVER;
  bench.settle(100);
  const third = bench.readings[TRIP_N - 1];
  const vent = bench.ventAt();
  return { ms: vent === null ? null : ms(vent - third), other, from_ms: ms(third - from) };
}

/** The host falls silent after a heartbeat; other requests do not count as one. */
function silent(bench) {
  const { host, random } = bench;
  let end = null;
  host.beat(() => {
    end = bench.board.nanos;
  });
  host.wait(5);
  bench.mark();
  let other = "";
  if (random() < 0.6) {
    host.wait(290 * random());
    other = bench.pick(REQUESTS);
    host.send(other);
  }
  bench.settle(500);
  const vent = bench.ventAt();
  return { ms: vent === null ? null : ms(vent - end), other };
}

/** Noise on the line at full rate: heartbeats in it are heard, and silence in it still vents. */
function garbage(bench) {
  const { board, host, random } = bench;
  const fill = () => {
    while (board.uart.line.length < 40) board.uart.send([Math.floor(256 * random())]);
  };
  const readings = bench.readings.length;
  bench.seen = host.events.length;
  let end = null;
  for (let beats = 0; beats < 4; beats++) {
    board.uart.send([0]);
    host.beat(() => {
      end = board.nanos;
    });
    const until = board.nanos + (60 + 80 * random()) * MS;
    while (board.nanos < until) {
      fill();
      board.run(board.nanos + MS);
    }
  }
  const early = bench.cause();
  const times = bench.readings.slice(readings);
  const gaps = times.slice(1).map((ns, k) => Math.abs(ns - times[k] - MS) / 1000);
  bench.mark();
  const limit = board.nanos + 500 * MS;
  while (board.nanos < limit && bench.cause() === null) {
    fill();
    board.run(board.nanos + MS);
  }
  board.uart.line.length = 0;
  board.uart.ends.length = 0;
  board.uart.send([0]);
  host.wait(30);
  const vent = bench.ventAt();
  return {
    ms: vent === null ? null : ms(vent - end),
    early,
    deviation_us: rounded(Math.max(...gaps)),
  };
}

/** A reading that cannot be true, from one moment on; the time counts from there. */
function sensor(counts, frozen) {
  return (bench) => {
    const { board, host } = bench;
    if (bench.scheme === "open") host.ask("pulse inlet 150000"); // refused while a train runs
    for (let k = 0; k < 40 && board.chamber.counts < PRESSURE; k++) host.keep(20);
    const before = board.chamber.counts;
    const from = bench.mark();
    board.forced = counts < 0 ? Math.max(1, before) : counts;
    board.frozen = frozen;
    while (bench.cause() === null && board.nanos < from + 600 * MS) host.keep(20);
    host.wait(5);
    const vent = bench.ventAt();
    return { ms: vent === null ? null : ms(vent - from), before };
  };
}

/** The program outside interrupts stands still. */
function hung(bench) {
  const { board, host } = bench;
  const from = bench.mark();
  board.hung = true;
  host.wait(20);
  host.beat(); // arrives, and is not answered
  host.wait(80);
  board.hung = false;
  bench.settle(100);
  const vent = bench.ventAt();
  return { ms: vent === null ? null : ms(vent - from) };
}

const KINDS = {
  over,
  silent,
  garbage,
  rail: sensor(4095, true),
  constant: sensor(-1, true),
  zero: sensor(0, false),
  hung,
};

export function trials(job, tell) {
  let bench = new Bench(job, tell);
  const rows = [];
  const errors = [];
  let seconds = 0;
  let toldAt = Date.now();
  let failed = "";
  for (let k = 0; k < job.trials; k++) {
    try {
      bench.prepare(job.first + k);
      bench.steps.length = 0;
      const row = KINDS[job.trial](bench);
      rows.push({
        number: job.first + k,
        scheme: bench.scheme,
        cause: bench.cause(),
        step_us: rounded(Math.max(...bench.steps)),
        ...row,
      });
    } catch (error) {
      if (!(error instanceof Reset)) {
        failed = `trial ${job.first + k}: ${error.message}`;
        break;
      }
      rows.push({
        number: job.first + k,
        scheme: bench.scheme,
        cause: "watchdog reset",
        faults: bench.faultsLatched(),
        step_us: rounded(Math.max(...bench.steps)),
        ms: null,
      });
      seconds += bench.board.nanos / 1e9;
      errors.push(...bench.host.errors);
      bench = new Bench(job, tell);
    }
    if (Date.now() - toldAt > 10000) {
      toldAt = Date.now();
      tell(`${k + 1} of ${job.trials}`);
    }
  }
  errors.push(...bench.host.errors);
  return {
    trial: job.trial,
    rows,
    failed,
    clock_hz: bench.board.rp.clkSys,
    times_ms: figures(rows.filter((row) => row.ms !== null).map((row) => row.ms)),
    errors: errors.filter((text) => !/err (verb|scheme|busy) /.test(text)),
    seconds: rounded(seconds + bench.board.nanos / 1e9),
  };
}
