// A pressure chamber with two delayed valves behind the converter: enough for the schemes to move.
const SUPPLY = 3282; // counts, absolute
const ATMOSPHERE = 415;
const RATE = 0.001727; // share per millisecond of a choked valve
const OPENS_US = 2000;
const CLOSES_US = 1500;
const STEP_NS = 50000;

/** Flow of a nozzle at this pressure ratio, as a share of the choked one. */
function nozzle(ratio) {
  if (ratio <= 0.5) return 1;
  return ratio >= 1 ? 0 : Math.sqrt(1 - (2 * ratio - 1) ** 2);
}

/** A valve that follows its command after a delay. */
class Valve {
  constructor(open) {
    this.open = open;
    this.since = open ? OPENS_US : -CLOSES_US; // us since the command changed; negative: to close
  }

  follow(command, us) {
    this.since = command ? Math.max(0, this.since) + us : Math.min(0, this.since) - us;
    if (this.since >= OPENS_US) this.open = true;
    else if (this.since <= -CLOSES_US) this.open = false;
  }
}

export class Chamber {
  constructor() {
    this.reset();
    this.atNs = 0;
  }

  /** At atmosphere, as after a vent. */
  reset() {
    this.pressure = ATMOSPHERE;
    this.inlet = new Valve(false);
    this.outlet = new Valve(true);
  }

  get counts() {
    return Math.round(this.pressure - ATMOSPHERE);
  }

  /** Advance to `now` under the valves' commands (functions of time, ns). */
  advance(now, inletOn, ventOn) {
    while (this.atNs < now) {
      const ns = Math.min(STEP_NS, now - this.atNs);
      this.inlet.follow(inletOn(this.atNs), ns / 1000);
      this.outlet.follow(ventOn(this.atNs), ns / 1000);
      const share = (RATE * ns) / 1e6;
      if (this.inlet.open) this.pressure += share * SUPPLY * nozzle(this.pressure / SUPPLY);
      if (this.outlet.open)
        this.pressure -= share * this.pressure * nozzle(ATMOSPHERE / this.pressure);
      this.atNs += ns;
    }
  }
}
