// Memory that the firmware takes while armed: a script on the chip reads gc.mem_alloc() around
// spans of the real loop, on request through two scratch registers of the watchdog.
import { Board } from "./board.mjs";
import { rounded } from "./figures.mjs";
import { Host } from "./host.mjs";

export function memory(job, tell) {
  const board = new Board(job);
  const host = new Host(board, job.guarded);
  let answer = -1;
  board.onScratch = (register, value) => {
    if (register === 0) answer = value;
  };
  // The script collects before the first reading of a span and not before the second.
  const read = (command) => {
    answer = -1;
    board.rp.writeUint32(0x40058010, command);
    host.wait(200, () => answer >= 0);
    if (answer < 0) throw new Error("the script on the board does not answer");
    return answer;
  };
  host.boot();
  const spans = {};
  let heap = null;
  for (const scheme of job.schemes) {
    host.set(job.inputs ?? []);
    host.arm();
    host.wait(30);
    if (scheme === "open") host.must("scheme open");
    else host.start(scheme);
    host.wait(60);
    const rows = [];
    for (let k = 0; k < job.spans; k++) {
      host.beat();
      // Within a span of 200 ms: two heartbeats, two set-points, telemetry, and a train's pulses.
      if (scheme === "open")
        host.must(k % 2 ? "pulse inlet 12345 5 40000" : "pulse vent 30000 6 40000");
      host.wait(20);
      const before = read(1);
      const from = board.nanos;
      for (let beat = 0; beat < 2; beat++) {
        host.beat();
        host.wait(60);
        if (scheme !== "idle" && scheme !== "open") host.send(`sp ${beat ? 16000 : 9000}`);
        host.wait(40);
      }
      rows.push([read(2) - before, (board.nanos - from) / 1e6]);
      heap = before;
      if (scheme === "open") host.wait(120); // the train is over
    }
    spans[scheme] = {
      bytes: rows.map((row) => row[0]),
      per_tick: rounded(
        rows.reduce((sum, row) => sum + row[0], 0) / rows.reduce((sum, row) => sum + row[1], 0),
        3,
      ),
    };
    tell(`${scheme}: ${spans[scheme].per_tick} B a tick`);
    host.must("stop");
    board.chamber.reset();
    host.wait(100);
  }
  return {
    spans,
    heap_used: heap,
    faults: host.events.map((event) => event[1]).filter((text) => text.startsWith("fault")),
    errors: host.errors,
    seconds: rounded(board.nanos / 1e9),
  };
}
