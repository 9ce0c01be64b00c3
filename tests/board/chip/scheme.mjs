// One scheme for some seconds as a host would run it: what every millisecond takes and loses.
import { Board } from "./board.mjs";
import { figures, rounded } from "./figures.mjs";
import { figuresOfTrips, Host } from "./host.mjs";

const BEAT_MS = 100;
const BRIDGE_MS = 12.5; // conversions of a bridge at 80 a second
const CHANGE_MS = 500;
let HOLD_US = 0; // valvefw.schemes.scheme.HOLD_US, from the job: a hold, which the scheme renews
const TICK_US = 1000;
const CUT_US = 100; // shorter than planned by more is cut
const SLOW = ["stat", "conf", "conf 20", "get trip", "faults", "timing", "telemetry 10", "help"];

/** What the host wants next of a scheme. */
function* changes(scheme) {
  if (scheme === "idle") return;
  if (scheme === "open") {
    while (true) {
      yield "pulse vent 30000 12 40000";
      yield "pulse inlet 12345 5 40000";
    }
  }
  while (true) {
    yield "sp 9000";
    yield "sp 16000";
  }
}

/**
 * Inlet pulses that end before the scheme or the host has ended them. A plan is what the loop
 * requests of the core (WANT_INLET) when the inlet was not wanted before: a pulse of so many us,
 * or a hold, which the scheme renews at each pass of the loop.
 */
class Pulses {
  constructor(board, state, places) {
    this.board = board;
    this.running = () => state(places.RUNNING);
    this.wanted = 0;
    this.plan = null;
    this.word = 0;
    this.at = 0;
    this.splits = [];
    this.off = []; // us by which a planned pulse was longer than its plan
    this.reset();
    board.watch(places.WANT_INLET, (wanted) => this.want(wanted));
  }

  reset() {
    this.started = 0;
    this.dropped = 0; // holds that ran out while the scheme still wanted them
    this.gaps = 0; // words that ran out long before the next one of the same pulse
    this.splits.length = 0; // and by so few us that the valve stays open
    this.off.length = 0;
  }

  want(wanted) {
    const now = this.board.nanos;
    if (wanted > 0 && this.wanted <= 0) {
      this.#finish();
      if (wanted !== HOLD_US) this.plan = { us: wanted, at: now, open: 0 };
    } else if (wanted > this.wanted) this.plan = null; // the scheme has another plan
    // The scheme may end its pulse before its time; only a late pass counts it down so far.
    if (wanted === 0 && this.wanted > 2 * TICK_US && this.plan) {
      if (this.plan.us - (now - this.plan.at) / 1000 > 2 * TICK_US) this.plan = null;
    }
    this.wanted = wanted;
  }

  drive(word) {
    const now = this.board.nanos;
    const past = (now - this.at) / 1000;
    if (!this.word && word) this.started++;
    if (this.plan) this.plan.open += Math.min(this.word, past);
    if (this.word >= TICK_US && word && past > this.word) {
      if (past - this.word > CUT_US) this.gaps++;
      else this.splits.push(past - this.word);
    }
    const counted = this.word && !word && this.word < 2 * TICK_US;
    if (counted && this.running() && this.wanted === HOLD_US) this.dropped++;
    this.word = word;
    this.at = now;
  }

  #finish() {
    if (this.plan) this.off.push(this.plan.open - this.plan.us);
    this.plan = null;
  }
}

export function scheme(job, tell) {
  HOLD_US = job.hold_us;
  const board = new Board(job);
  const host = new Host(board, job.guarded);
  const counts = { collections: 0, allocated: 0 };
  if (job.symbols) {
    board.hookAt(job.symbols.gc_collect, () => counts.collections++);
    board.hookAt(job.symbols.gc_alloc, (core) => {
      counts.allocated += Math.ceil(core.registers[0] / 16) * 16;
    });
  }
  const ident = host.boot();
  const state = board.findState(job);
  const pulses = new Pulses(board, state, job.places);
  const conversions = [];
  const steps = [];
  const passes = []; // us from the first step that a pass of the loop has not seen to that pass
  let measuring = false;
  let waitingSince = 0;
  let ticks = state(job.places.TICKS);
  let mostTicks = 0;
  board.onConversion = () => {
    waitingSince ||= board.nanos;
    if (measuring) conversions.push(board.nanos);
  };
  board.onStep = (start, end) => {
    if (measuring) steps.push((end - start) / 1000);
  };
  board.onFeed = () => {
    const now = state(job.places.TICKS);
    if (measuring && waitingSince) {
      passes.push((board.nanos - waitingSince) / 1000);
      mostTicks = Math.max(mostTicks, now - ticks);
    }
    waitingSince = 0;
    ticks = now;
  };
  board.onWord = (machine, word) => {
    if (machine === 0) pulses.drive(word);
  };
  host.set(job.inputs ?? []);
  host.arm();
  host.wait(30);
  host.start(job.scheme);
  host.wait(50);
  host.must("timing"); // from here on

  measuring = true;
  host.trips = [];
  host.gaps = host.samples = 0;
  host.inputs = {};
  pulses.reset();
  Object.assign(counts, { collections: 0, allocated: 0 });
  const events = host.events.length;
  const from = board.nanos;
  const idle = board.idleNs;
  const wanted = changes(job.scheme);
  let beatAt = from + 1e6;
  let wordAt = job.inputs ? from + 1e6 : Infinity;
  let word = 1000;
  let changeAt = from + CHANGE_MS * 1e6;
  let toldAt = Date.now();
  const to = from + job.seconds * 1e9;
  while (board.nanos < to) {
    board.run(Math.min(to, beatAt, changeAt, wordAt));
    if (board.nanos >= wordAt) {
      // What the bridge's state machine would have read: the machines themselves stand still.
      word = (word * 7 + 3) % 8000000;
      board.rp.pio[0].machines[2].rxFIFO.push(word);
      wordAt += BRIDGE_MS * 1e6;
    }
    if (board.nanos >= beatAt) {
      host.beat();
      beatAt += BEAT_MS * 1e6;
    }
    if (board.nanos >= changeAt) {
      const text = wanted.next().value;
      if (text) host.send(text);
      changeAt += CHANGE_MS * 1e6;
    }
    if (Date.now() - toldAt > 10000) {
      toldAt = Date.now();
      tell(`${((board.nanos - from) / 1e9).toFixed(1)} of ${job.seconds} s`);
    }
  }
  measuring = false;
  const measuredTicks = mostTicks;
  const seconds = (board.nanos - from) / 1e9;
  const busy = 1 - (board.idleNs - idle) / (board.nanos - from);
  const { collections, allocated } = counts;
  const gaps = host.gaps;
  const { samples } = host;
  const faults = host.events.slice(events).map((event) => event[1]);
  const trips = figuresOfTrips(host.trips, figures);
  const loop = figures(passes);
  const step = figures(steps);
  const intervals = [];
  let lost = 0;
  for (let k = 1; k < conversions.length; k++) {
    intervals.push((conversions[k] - conversions[k - 1]) / 1000);
    lost += Math.max(0, Math.round(intervals.at(-1) / TICK_US) - 1);
  }
  const own = host.must("timing");

  // Requests that are answered in Python, one by one; what each does to loop and step.
  const slow = {};
  for (const text of SLOW) {
    host.beat();
    host.wait(20);
    const before = passes.length;
    measuring = true;
    host.trips = [];
    host.must(text);
    host.wait(5);
    measuring = false;
    slow[text] = {
      ms: rounded(host.trips[0][1] / 1e6),
      late_us: rounded(Math.max(0, ...passes.slice(before))),
    };
    passes.length = before;
  }

  return {
    scheme: job.scheme,
    ident,
    boot_ms: rounded(host.bootMs),
    clock_hz: board.rp.clkSys,
    flash_divider: board.flashClock.baudr,
    safety_irq: board.safetyIrq,
    seconds: rounded(seconds, 3),
    interval_us: figures(intervals),
    deviation_us: figures(intervals.map((us) => Math.abs(us - TICK_US))),
    lost,
    step_us: step,
    busy: rounded(busy, 4),
    loop_us: loop,
    loop_ticks: measuredTicks,
    pulses: pulses.started,
    cut: pulses.gaps + pulses.dropped + pulses.off.filter((us) => us < -CUT_US).length,
    cut_gaps: pulses.gaps,
    cut_holds: pulses.dropped,
    splits_us: figures(pulses.splits),
    longer: pulses.off.filter((us) => us > CUT_US).length,
    off_us: figures(pulses.off),
    collections: job.symbols ? collections : null,
    allocated_per_tick: job.symbols ? rounded(allocated / conversions.length) : null,
    samples,
    inputs: job.inputs ? host.inputs : undefined,
    gaps,
    damaged: host.damaged,
    overrun: board.uart.overrun,
    trips,
    slow,
    timing: own,
    errors: host.errors,
    faults,
  };
}
