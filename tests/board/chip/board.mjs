// A Raspberry Pi Pico: rp2040js, and what a measurement of time needs beyond it:
//  - cycles of the processor (core.mjs) and of the flash cache (16 kB, 2 ways, lines of 8 bytes);
//  - UARTs with FIFOs at their real speed (uart.mjs);
//  - the two pulse programs: as functions of the words in their FIFOs (fast), or executed
//    instruction by instruction at their own clock (`realPio`);
//  - a chamber behind the converter (chamber.mjs).
import fs from "node:fs";
import { ConsoleLogger, LogLevel, RP2040 } from "rp2040js";
import { Chamber } from "./chamber.mjs";
import { stepper } from "./core.mjs";
import { fix } from "./fixes.mjs";
import { Uart } from "./uart.mjs";

const FLASH = 0x10000000;
const SRAM = 0x20000000;
const WATCHDOG_LOAD = 0x40058004;
const SCRATCH = 0x4005800c;
const PIO0_TX = 0x50200010;
const PIO_FROM = 0x50200000;
const PIO_TO = 0x50400000;
const BAUD = 115200;
const DESK_SPEED = 8; // of UART1 over UART0: it carries what takes no part in a measurement
const CACHE_SETS = 1024;
// A miss reads 4 bytes from the flash: 20 of its clocks with an address (quad I/O, continuous
// read), and 3 of the processor's. Longer runs of the real cache's reads are cheaper.
const MISS_FLASH_CLOCKS = 20;
const MISS_CLOCKS = 3;
const SILENCE_US = 20000; // valvefw.board.DRIVE_SILENCE_US: the outlet's words count from it
const RETURN_CYCLES = 16; // of an exception return, not yet in the clock when it is seen

/** Index of an address in the table of hooks: flash, then SRAM. */
const hookIndex = (pc) => (pc >= SRAM ? ((pc - SRAM) >> 1) + 0x100000 : (pc & 0x1fffff) >> 1);

/** The chip would start anew; the emulation ends instead. */
export class Reset extends Error {}

export class Board {
  /** `job`: image, bootrom and filesystem as paths, filesystemAt, realPio, symbols. */
  constructor(job) {
    const rp = (this.rp = new RP2040());
    this.clock = rp.clock;
    this.core = rp.core;
    this.realPio = !!job.realPio;
    rp.logger = new ConsoleLogger(LogLevel.Error);
    for (const level of ["warn", "info", "debug"]) rp.logger[level] = () => {};
    const bootrom = fs.readFileSync(job.bootrom);
    rp.loadBootrom(new Uint32Array(new Uint8Array(bootrom).buffer));
    rp.flash.fill(0xff);
    rp.flash.set(fs.readFileSync(job.image), 0);
    rp.flash.set(fs.readFileSync(job.filesystem), job.filesystemAt);
    const byteNs = 1e10 / BAUD;
    this.uart = new Uart(rp, "UART0", 20, byteNs);
    this.desk = new Uart(rp, "UART1", 21, byteNs / DESK_SPEED);
    rp.uart = [this.uart, this.desk];
    rp.peripherals[0x40034] = this.uart;
    rp.peripherals[0x40038] = this.desk;
    this.flashClock = rp.peripherals[0x18000];
    this.idleNs = 0;
    this.stall = 0; // cycles of cache misses since the last instruction
    this.tags = new Int32Array(2 * CACHE_SETS).fill(-1);
    this.valid = new Uint8Array(2 * CACHE_SETS);
    this.older = new Uint8Array(CACHE_SETS);
    this.hung = false; // true: the program outside interrupts stands still
    this.masked = 0; // interrupts that do not reach the processor, as bits
    this.onWord = () => {}; // (state machine, word) written by the program
    this.onConversion = () => {}; // a conversion of the pressure input starts
    this.onFeed = () => {}; // the watchdog is fed
    this.onScratch = () => {}; // (register, value)
    this.onStep = () => {}; // (start, end) of the safety core's interrupt, ns
    this.onPin = () => {}; // (pin, level), with realPio
    this.watched = -1; // byte of SRAM whose word is watched
    this.onWatched = () => {};
    this.hooks = new Map();
    this.#memory();
    this.#pio();
    this.#converter();
    this.#interrupts();
    const watchdog = rp.peripherals[0x40058];
    watchdog.onWatchdogTrigger = () => {
      watchdog.alarm.enable = false; // it would fire for ever
      throw new Reset(`the watchdog resets the chip at ${(this.nanos / 1e6).toFixed(1)} ms`);
    };
    fix(rp);
    this.core.PC = FLASH;
    this.step = stepper(this.core);
  }

  get nanos() {
    return this.clock.nanos;
  }

  #cached(address) {
    const word = (address & 0xffffff) >> 2;
    const line = word >> 1;
    const set = line & (CACHE_SETS - 1);
    const tag = line >> 10;
    const bit = 1 << (word & 1);
    let way = set << 1;
    if (this.tags[way] === tag) this.older[set] = 1;
    else if (this.tags[way + 1] === tag) {
      this.older[set] = 0;
      way += 1;
    } else {
      const out = this.older[set];
      this.older[set] = 1 - out;
      way += out;
      this.tags[way] = tag;
      this.valid[way] = 0;
    }
    if (this.valid[way] & bit) return;
    this.valid[way] |= bit;
    this.stall += this.missCycles;
  }

  /** Reads and writes of the processor: SRAM and flash directly, the rest through rp2040js. */
  #memory() {
    const { core, rp } = this;
    const { flash, sram } = rp;
    const flash16 = new Uint16Array(flash.buffer, flash.byteOffset, flash.length >> 1);
    const flash32 = new Uint32Array(flash.buffer, flash.byteOffset, flash.length >> 2);
    const sram16 = new Uint16Array(sram.buffer);
    const sram32 = (this.sram32 = new Int32Array(sram.buffer));
    const size = sram.length;
    core.readUint16 = (address) => {
      address >>>= 0;
      const at = address - SRAM;
      if (at >= 0 && at < size) return sram16[at >> 1];
      if (address >>> 24 === 0x10) {
        this.#cached(address);
        return flash16[(address & 0xffffff) >> 1];
      }
      return rp.readUint16(address);
    };
    core.readUint32 = (address) => {
      address >>>= 0;
      const at = address - SRAM;
      if (at >= 0 && at < size) return sram32[at >> 2];
      if (address >>> 24 === 0x10) {
        this.#cached(address);
        return flash32[(address & 0xffffff) >> 2];
      }
      return rp.readUint32(address);
    };
    core.readUint8 = (address) => {
      address >>>= 0;
      const at = address - SRAM;
      if (at >= 0 && at < size) return sram[at];
      if (address >>> 24 === 0x10) {
        this.#cached(address);
        return flash[address & 0xffffff];
      }
      return rp.readUint8(address);
    };
    core.writeUint32 = (address, value) => {
      address >>>= 0;
      const at = address - SRAM;
      if (at >= 0 && at < size) {
        sram32[at >> 2] = value;
        if (at === this.watched) this.onWatched(value | 0);
      } else this.#peripheral(address, value >>> 0);
    };
  }

  #peripheral(address, value) {
    if (address === WATCHDOG_LOAD) this.onFeed();
    else if (address >= SCRATCH && address < SCRATCH + 16) {
      this.onScratch((address - SCRATCH) >> 2, value);
    } else if (address === PIO0_TX || address === PIO0_TX + 4) {
      const machine = (address - PIO0_TX) >> 2;
      this.onWord(machine, value);
      if (!this.realPio) {
        this.#advance();
        this.words[machine] = value;
        this.wordAt[machine] = this.nanos;
        return;
      }
    }
    if (address >= PIO_FROM && address < PIO_TO) this.pioNext = 0;
    this.rp.writeUint32(address, value);
  }

  #pio() {
    this.words = [0, 0];
    this.wordAt = [0, 0];
    this.pioNext = 0;
    // rp2040js would step every machine at one speed, and without the delays of instructions.
    for (const pio of this.rp.pio) pio.run = () => {};
    for (const pin of [2, 3]) {
      this.rp.gpio[pin].addListener((state) => this.onPin(pin, state === 1 ? 1 : 0));
    }
  }

  #runPio() {
    const now = this.nanos;
    const cycle = 1e9 / this.rp.clkSys;
    let next = now + 100000;
    const pio = this.rp.pio[0];
    for (const machine of pio.machines) {
      if (!machine.enabled) {
        machine.dueNs = 0;
        continue;
      }
      machine.dueNs ||= now;
      const period = ((machine.clockDivInt || 65536) + machine.clockDivFrac / 256) * cycle;
      while (machine.dueNs <= now) {
        const before = machine.cycles;
        machine.step();
        machine.dueNs += period * Math.max(1, machine.cycles - before);
      }
      next = Math.min(next, machine.dueNs);
    }
    pio.checkChangedPins();
    this.pioNext = next;
  }

  /** The inlet's valve is energised: a word counts down once. */
  inletOn(ns) {
    if (this.realPio) return !!(this.rp.pio[0].pinValues & 4);
    return ns - this.wordAt[0] < this.words[0] * 1000;
  }

  /** The outlet is open. It is normally open: a word above 20000 opens it until 20 ms are left. */
  ventOn(ns) {
    if (this.realPio) return !(this.rp.pio[0].pinValues & 8);
    const word = this.words[1];
    const past = (ns - this.wordAt[1]) / 1000;
    return past >= word || (word > SILENCE_US && past < word - SILENCE_US);
  }

  #advance() {
    this.chamber.advance(
      this.nanos,
      (ns) => this.inletOn(ns),
      (ns) => this.ventOn(ns),
    );
  }

  #converter() {
    const { adc } = this.rp;
    this.chamber = new Chamber();
    this.forced = -1; // counts in place of the chamber's, with noise
    this.frozen = false; // true: without noise
    this.noise = 0;
    adc.onADCRead = (channel) => {
      this.#advance();
      if (channel === 0) {
        if (this.running) this.running.safety = true;
        this.onConversion();
      }
      if (!this.frozen) this.noise ^= 1;
      const counts = this.forced >= 0 ? this.forced : this.chamber.counts;
      adc.currentChannel = channel;
      adc.channelValues[channel] = Math.max(0, Math.min(4095, counts + this.noise));
      adc.sampleAlarm.schedule(2000);
    };
  }

  /** The safety core's interrupt is the one that starts a conversion of the pressure input. */
  #interrupts() {
    const { core } = this;
    const entry = core.exceptionEntry.bind(core);
    const leave = core.exceptionReturn.bind(core);
    const raise = core.setInterrupt.bind(core);
    const stack = [];
    core.setInterrupt = (irq, value) => raise(irq, value && !((this.masked >>> irq) & 1));
    core.exceptionEntry = (number) => {
      this.running = { number, start: this.nanos, safety: false };
      stack.push(this.running);
      entry(number);
    };
    core.exceptionReturn = (value) => {
      const ended = stack.pop();
      this.running = stack.at(-1);
      if (ended?.safety) {
        this.safetyIrq = ended.number - 16;
        this.onStep(ended.start, this.nanos + RETURN_CYCLES * this.cycleNs);
      }
      leave(value);
    };
  }

  /** Call `hook` before the instruction at `address`. */
  hookAt(address, hook) {
    this.hooks.set((address & ~1) >>> 0, hook);
    this.hooked ??= new Uint8Array(0x1c0000);
    this.hooked[hookIndex(address & ~1)] = 1;
  }

  /** Run until the time, or until `stop` says so (asked about each 1000 instructions). */
  run(untilNs, stop = () => false) {
    const { core, clock, rp, realPio, step } = this;
    const registers = core.registers;
    let asked = 0;
    while (clock.nanos < untilNs) {
      if ((asked++ & 1023) === 0) {
        this.cycleNs = 1e9 / rp.clkSys;
        this.missCycles = MISS_FLASH_CLOCKS * (this.flashClock.baudr || 2) + MISS_CLOCKS;
        if (stop()) return;
      }
      // Without: an interrupt that became due after the mask was set and before `wfi` does not end
      // the sleep, which then lasts until the next other interrupt, up to some ms.
      if (core.waiting && core.pendingInterrupts & core.enabledInterrupts) {
        if (core.checkForInterrupts()) {
          core.waiting = false;
          clock.tick(15 * this.cycleNs);
          continue;
        }
      }
      const stands = this.hung && core.IPSR === 0 && !core.PM;
      if (core.waiting || (stands && !core.interruptsUpdated)) {
        let ns = clock.nanosToNextAlarm;
        if (ns <= 0) ns = this.cycleNs;
        else {
          ns = Math.min(ns, untilNs - clock.nanos);
          if (realPio) ns = Math.max(this.cycleNs, Math.min(ns, this.pioNext - clock.nanos));
          this.idleNs += ns;
        }
        clock.tick(ns);
        if (realPio && this.pioNext <= clock.nanos) this.#runPio();
        continue;
      }
      if (stands) {
        if (core.checkForInterrupts()) clock.tick(15 * this.cycleNs);
        continue;
      }
      if (this.hooked !== undefined) {
        const pc = registers[15] >>> 0;
        if (this.hooked[hookIndex(pc)] === 1) this.hooks.get((pc & ~1) >>> 0)?.(core);
      }
      let cycles = step();
      if (this.stall) {
        cycles += this.stall;
        this.stall = 0;
      }
      clock.tick(cycles * this.cycleNs);
      if (realPio && this.pioNext <= clock.nanos) this.#runPio();
    }
  }

  /** Find the safety core's state in memory by the limits that it holds; no symbols needed. */
  findState(job) {
    const wanted = Object.entries(job.limits).map(([place, value]) => [Number(place), value]);
    const found = [];
    for (let at = 0; at + job.words <= this.sram32.length; at++) {
      if (wanted.every(([place, value]) => this.sram32[at + place] === value)) found.push(at);
    }
    if (found.length !== 1) {
      throw new Error(`the safety core's state is in memory ${found.length} times, expected once`);
    }
    const base = found[0];
    this.watch = (place, seen) => {
      this.watched = 4 * (base + place);
      this.onWatched = seen;
    };
    return (place) => this.sram32[base + place];
  }
}
