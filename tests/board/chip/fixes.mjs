// Where rp2040js 1.4.1 differs from the RP2040 in what the firmware uses. `fix` changes one chip.

/** Correct a chip; each correction states what is wrong without it. */
export function fix(rp) {
  const { clock, adc } = rp;

  // Without: AINSEL is written through its shift (12) in place of its mask (7): round robin of a
  // capture never leaves input 0.
  Object.defineProperty(adc, "activeChannel", {
    get() {
      return (this.cs >> 12) & 7;
    },
    set(channel) {
      this.cs = (this.cs & ~(7 << 12)) | ((channel & 7) << 12);
    },
  });

  // Without: free running is timed from the end of a conversion, so a capture is 2 us a sample slow.
  adc.startADCRead = function () {
    this.busy = true;
    this.startedAt = clock.nanos;
    this.onADCRead(this.activeChannel);
  };
  const complete = adc.completeADCRead;
  adc.completeADCRead = function (value, error) {
    const start = this.startedAt;
    complete.call(this, value, error);
    const freeRunning = this.cs & 8;
    if (freeRunning && this.divider > 96) {
      const next = start + (this.divider * 1e9) / 48e6;
      this.multiShotAlarm.schedule(Math.max(0, next - clock.nanos));
    }
  };

  // Without: timer alarms fire up to 1 us early, and the alarm pool then waits for them in its
  // interrupt.
  const timer = rp.peripherals[0x40054];
  const write = timer.writeUint32;
  timer.writeUint32 = function (offset, value) {
    write.call(this, offset, value);
    if (offset >= 0x10 && offset <= 0x1c) {
      const alarm = this.alarms[(offset - 0x10) >> 2];
      const now = Math.floor(clock.nanos / 1000);
      const ahead = (value - now) >>> 0 || 2 ** 32;
      alarm.clockAlarm.schedule((now + ahead) * 1000 - clock.nanos);
    }
  };
}
