// UART of the RP2040 (data sheet 4.2) at its real speed: two 32-byte FIFOs, thresholds and the
// receive time-out. rp2040js has neither FIFOs nor baud rate.
import { BasePeripheral } from "rp2040js";

const THRESHOLDS = [4, 8, 16, 24, 28];
const DEPTH = 32;
const RX_LEVEL = 0x10;
const TX_LEVEL = 0x20;
const RX_TIMEOUT = 0x40;

export class Uart extends BasePeripheral {
  constructor(rp, name, irq, byteNs) {
    super(rp, name);
    const clock = rp.clock;
    this.irq = irq;
    this.byteNs = byteNs;
    this.tx = [];
    this.rx = [];
    this.sending = false;
    this.imsc = 0;
    this.ris = 0;
    this.ifls = 0x12;
    this.registers = new Map();
    this.overrun = 0; // bytes lost because the receive FIFO was full
    this.onByte = () => {}; // a byte of the chip has left
    this.line = []; // bytes of the host still to arrive
    this.ends = []; // [bytes still before it, function] for the end of each message
    this.txAlarm = clock.createAlarm(() => this.sent());
    this.lineAlarm = clock.createAlarm(() => this.arrived());
    this.timeoutAlarm = clock.createAlarm(() => {
      if (this.rx.length) {
        this.ris |= RX_TIMEOUT;
        this.update();
      }
    });
  }

  get clkPeriChanged() {
    return () => {};
  }

  /** Bytes from the host; `done` is called when the last one has arrived. */
  send(bytes, done) {
    const idle = this.line.length === 0;
    for (const byte of bytes) this.line.push(byte);
    if (done) this.ends.push([this.line.length, done]);
    if (idle && this.line.length) this.lineAlarm.schedule(this.byteNs);
  }

  arrived() {
    const byte = this.line.shift();
    if (this.rx.length < DEPTH) this.rx.push(byte);
    else this.overrun++;
    if (this.rx.length >= this.rxThreshold()) this.ris |= RX_LEVEL;
    this.timeoutAlarm.schedule(this.byteNs * 3.2); // 32 bits
    this.update();
    if (this.line.length) this.lineAlarm.schedule(this.byteNs);
    for (const end of this.ends) end[0]--;
    while (this.ends.length && this.ends[0][0] <= 0) this.ends.shift()[1]();
  }

  sent() {
    this.sending = false;
    this.onByte(this.leaving);
    this.transmit();
  }

  transmit() {
    if (this.sending || !this.tx.length) return;
    this.sending = true;
    this.leaving = this.tx.shift();
    this.txAlarm.schedule(this.byteNs);
    if (this.tx.length === this.txThreshold()) {
      this.ris |= TX_LEVEL;
      this.update();
    }
  }

  update() {
    this.rp2040.setInterrupt(this.irq, !!(this.ris & this.imsc));
  }

  txThreshold() {
    return THRESHOLDS[this.ifls & 7];
  }

  rxThreshold() {
    return THRESHOLDS[(this.ifls >> 3) & 7];
  }

  readUint32(offset) {
    switch (offset) {
      case 0x00: {
        const byte = this.rx.length ? this.rx.shift() : 0;
        if (this.rx.length < this.rxThreshold()) this.ris &= ~RX_LEVEL;
        if (!this.rx.length) this.ris &= ~RX_TIMEOUT;
        this.update();
        return byte;
      }
      case 0x18: // flags
        return (
          (this.tx.length ? 0 : 0x80) |
          (this.rx.length >= DEPTH ? 0x40 : 0) |
          (this.tx.length >= DEPTH ? 0x20 : 0) |
          (this.rx.length ? 0 : 0x10) |
          (this.sending || this.tx.length ? 8 : 0)
        );
      case 0x30:
        return this.registers.get(0x30) ?? 0x300;
      case 0x34:
        return this.ifls;
      case 0x38:
        return this.imsc;
      case 0x3c:
        return this.ris;
      case 0x40:
        return this.ris & this.imsc;
      default:
        return this.registers.get(offset) ?? 0;
    }
  }

  writeUint32(offset, value) {
    switch (offset) {
      case 0x00:
        if (this.tx.length < DEPTH) this.tx.push(value & 255);
        if (this.tx.length > this.txThreshold()) this.ris &= ~TX_LEVEL;
        this.transmit();
        this.update();
        break;
      case 0x34:
        this.ifls = value;
        break;
      case 0x38:
        this.imsc = value;
        this.update();
        break;
      case 0x44:
        this.ris &= ~this.rawWriteValue;
        this.update();
        break;
      default:
        this.registers.set(offset, value);
    }
  }
}
