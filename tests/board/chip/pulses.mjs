// The pulse programs executed instruction by instruction: times of the edges at the two pins.
import { Board } from "./board.mjs";
import { figures, randomNumbers, rounded } from "./figures.mjs";
import { Host } from "./host.mjs";

const PINS = { inlet: 2, vent: 3 };
// Level of each pin while its valve's coil is energised: the inlet opens, the outlet shuts.
const OPEN_LEVEL = { inlet: 1, vent: 0 };
const HELD_MS = 200;

export function pulses(job, tell) {
  const board = new Board({ ...job, realPio: true });
  const host = new Host(board, job.guarded);
  const random = randomNumbers(job.seed + 1);
  const edges = []; // [ns, pin, level]
  board.onPin = (pin, level) => edges.push([board.nanos, pin, level]);
  host.boot();
  host.arm();
  host.start("idle");
  host.must("scheme open");
  host.keep(30);
  // Held: both shut, then each one open for as long as a pulse may last.
  const held = {};
  for (const valve of ["", "inlet", "vent"]) {
    host.beat();
    if (valve) host.must(`pulse ${valve} ${(HELD_MS + 60) * 1000}`);
    host.wait(10);
    edges.length = 0;
    host.keep(HELD_MS);
    held[valve || "shut"] = edges.length;
    host.keep(100);
  }

  const widths = {};
  const spoiled = [];
  for (const valve of ["inlet", "vent"]) {
    for (const us of job.widths) {
      const measured = [];
      for (let k = 0; k < job.repeats; k++) {
        host.beat();
        host.wait(10 + 3 * random());
        edges.length = 0;
        host.must(`pulse ${valve} ${us}`);
        host.wait(us / 1000 + 22);
        const own = edges.filter((edge) => edge[1] === PINS[valve]);
        const levels = own.map((edge) => edge[2]).join("");
        if (edges.length !== 2 || levels !== (OPEN_LEVEL[valve] ? "10" : "01")) {
          spoiled.push({ valve, us, edges: edges.map((edge) => [edge[1], edge[2]]) });
        } else measured.push((own[1][0] - own[0][0]) / 1000);
      }
      widths[`${valve} ${us}`] = figures(measured);
      tell(`${valve} ${us} us`);
    }
  }

  // Without words both coils are de-energised: the interrupt stops, then the whole processor.
  const released = {};
  for (const how of ["interrupt stops", "processor stops"]) {
    const times = [];
    for (let k = 0; k < job.repeats; k++) {
      host.beat();
      host.must("pulse inlet 200000");
      host.wait(15 + 3 * random());
      edges.length = 0;
      const from = board.nanos;
      const irqs = how === "interrupt stops" ? 1 << board.safetyIrq : -1;
      board.masked = irqs;
      if (irqs === -1) board.hung = true;
      board.rp.setInterrupt(board.safetyIrq, false);
      host.wait(30);
      const off = edges.filter((edge) => edge[2] === 0);
      const last = Object.values(PINS).map((pin) => off.find((edge) => edge[1] === pin)?.[0]);
      times.push(Math.max(...last.map((ns) => (ns === undefined ? Infinity : ns - from))) / 1e6);
      board.masked = 0;
      board.hung = false;
      board.rp.setInterrupt(board.safetyIrq, true);
      host.wait(60);
      board.chamber.reset();
      host.wait(10);
      host.must("clear");
      host.arm();
      host.must("scheme open");
      host.keep(20);
    }
    released[how] = times.some((ms) => !Number.isFinite(ms)) ? null : figures(times);
    tell(how);
  }
  return {
    clock_hz: board.rp.clkSys,
    widths_us: widths,
    spoiled,
    held_edges: held,
    released_ms: released,
    faults: host.events.map((event) => event[1]).filter((text) => text.startsWith("fault")),
    seconds: rounded(board.nanos / 1e9),
  };
}
