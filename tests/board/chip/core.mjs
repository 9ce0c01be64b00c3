// A table-driven Cortex-M0+ for rp2040js's core object: the same registers, flags and exceptions, cycle counts of the
// M0+ TRM (RP2040: single-cycle multiplier, zero-wait SRAM). Rare opcodes fall back to rp2040js itself.
const T = new Uint8Array(65536);
const [
  FALL,
  LSLI,
  LSRI,
  ASRI,
  ADDR,
  SUBR,
  ADD3,
  SUB3,
  MOVI,
  CMPI,
  ADDI,
  SUBI,
  ANDS,
  EORS,
  LSLR,
  LSRR,
  ASRR,
  ADCS,
  SBCS,
  TST,
  RSBS,
  CMPR,
  CMN,
  ORRS,
  MULS,
  BICS,
  MVNS,
  HADD,
  HCMP,
  HMOV,
  BX,
  BLX,
  LDRL,
  STRR,
  STRHR,
  STRBR,
  LDRSB,
  LDRR,
  LDRHR,
  LDRBR,
  LDRSH,
  STRI,
  LDRI,
  STRBI,
  LDRBI,
  STRHI,
  LDRHI,
  STRSP,
  LDRSP,
  ADR,
  ADDSPR,
  ADDSP,
  SUBSP,
  SXTH,
  SXTB,
  UXTH,
  UXTB,
  PUSH,
  POP,
  LDM,
  STM,
  BCC,
  B,
  BL,
  NOP,
] = [...Array(65).keys()];
for (let o = 0; o < 65536; o++) {
  const t5 = o >> 11;
  let k = FALL;
  if (t5 === 0) k = LSLI;
  else if (t5 === 1) k = LSRI;
  else if (t5 === 2) k = ASRI;
  else if (t5 === 3) k = [ADDR, SUBR, ADD3, SUB3][(o >> 9) & 3];
  else if (t5 === 4) k = MOVI;
  else if (t5 === 5) k = CMPI;
  else if (t5 === 6) k = ADDI;
  else if (t5 === 7) k = SUBI;
  else if (o >> 10 === 0b010000)
    k = [
      ANDS,
      EORS,
      LSLR,
      LSRR,
      ASRR,
      ADCS,
      SBCS,
      FALL,
      TST,
      RSBS,
      CMPR,
      CMN,
      ORRS,
      MULS,
      BICS,
      MVNS,
    ][(o >> 6) & 15];
  else if (o >> 8 === 0x44) k = HADD;
  else if (o >> 8 === 0x45) k = HCMP;
  else if (o >> 8 === 0x46) k = HMOV;
  else if (o >> 7 === 0b010001110) k = BX;
  else if (o >> 7 === 0b010001111) k = BLX;
  else if (t5 === 9) k = LDRL;
  else if (o >> 12 === 5) k = [STRR, STRHR, STRBR, LDRSB, LDRR, LDRHR, LDRBR, LDRSH][(o >> 9) & 7];
  else if (t5 === 12) k = STRI;
  else if (t5 === 13) k = LDRI;
  else if (t5 === 14) k = STRBI;
  else if (t5 === 15) k = LDRBI;
  else if (t5 === 16) k = STRHI;
  else if (t5 === 17) k = LDRHI;
  else if (t5 === 18) k = STRSP;
  else if (t5 === 19) k = LDRSP;
  else if (t5 === 20) k = ADR;
  else if (t5 === 21) k = ADDSPR;
  else if (o >> 7 === 0b101100000) k = ADDSP;
  else if (o >> 7 === 0b101100001) k = SUBSP;
  else if (o >> 6 === 0b1011001000) k = SXTH;
  else if (o >> 6 === 0b1011001001) k = SXTB;
  else if (o >> 6 === 0b1011001010) k = UXTH;
  else if (o >> 6 === 0b1011001011) k = UXTB;
  else if (o >> 9 === 0b1011010) k = PUSH;
  else if (o >> 9 === 0b1011110) k = POP;
  else if (o === 0xbf00) k = NOP;
  else if (t5 === 24) k = STM;
  else if (t5 === 25) k = LDM;
  else if (o >> 12 === 13 && ((o >> 8) & 15) < 14) k = BCC;
  else if (t5 === 28) k = B;
  else if (t5 === 30) k = BL;
  T[o] = k;
}
const bits = new Uint8Array(512);
for (let i = 1; i < 512; i++) bits[i] = bits[i >> 1] + (i & 1);

export function stepper(core) {
  const R = core.registers;
  const io = (a, w) => {
    a >>>= 0;
    return a < 0x40000000
      ? 2
      : a >= 0xd0000000 && a < 0xe0000000
        ? 1
        : a < 0x50000000
          ? w
            ? 5
            : 4
          : 2;
  };
  const add = (a, b, c) => {
    const s = a + b + c;
    const r = s >>> 0;
    core.N = r > 0x7fffffff;
    core.Z = r === 0;
    core.C = s > 0xffffffff;
    core.V = (~(a ^ b) & (a ^ r) & 0x80000000) !== 0;
    return r;
  };
  const nz = (r) => {
    core.N = r < 0;
    core.Z = r === 0;
  };
  return function step() {
    let extra = 0;
    if (core.interruptsUpdated) {
      if (core.checkForInterrupts()) {
        core.waiting = false;
        extra = 15;
      }
    }
    const pc = R[15] & ~1,
      o = core.readUint16(pc);
    const k = T[o];
    if (k === FALL) return core.executeInstruction() + extra;
    let np = pc + 2,
      c = 1,
      r;
    switch (k) {
      case LSLI: {
        const n = (o >> 6) & 31,
          v = R[(o >> 3) & 7];
        r = v << n;
        if (n) core.C = ((v >>> (32 - n)) & 1) === 1;
        R[o & 7] = r;
        nz(r | 0);
        break;
      }
      case LSRI: {
        const n = (o >> 6) & 31,
          v = R[(o >> 3) & 7];
        r = n ? v >>> n : 0;
        core.C = ((v >>> (n ? n - 1 : 31)) & 1) === 1;
        R[o & 7] = r;
        nz(r | 0);
        break;
      }
      case ASRI: {
        const n = (o >> 6) & 31,
          v = R[(o >> 3) & 7] | 0;
        r = n ? v >> n : v >> 31;
        core.C = ((v >> (n ? n - 1 : 31)) & 1) === 1;
        R[o & 7] = r;
        nz(r);
        break;
      }
      case ADDR:
        R[o & 7] = add(R[(o >> 3) & 7], R[(o >> 6) & 7], 0);
        break;
      case SUBR:
        R[o & 7] = add(R[(o >> 3) & 7], ~R[(o >> 6) & 7] >>> 0, 1);
        break;
      case ADD3:
        R[o & 7] = add(R[(o >> 3) & 7], (o >> 6) & 7, 0);
        break;
      case SUB3:
        R[o & 7] = add(R[(o >> 3) & 7], ~((o >> 6) & 7) >>> 0, 1);
        break;
      case MOVI:
        r = o & 255;
        R[(o >> 8) & 7] = r;
        core.N = false;
        core.Z = r === 0;
        break;
      case CMPI:
        add(R[(o >> 8) & 7], ~(o & 255) >>> 0, 1);
        break;
      case ADDI:
        R[(o >> 8) & 7] = add(R[(o >> 8) & 7], o & 255, 0);
        break;
      case SUBI:
        R[(o >> 8) & 7] = add(R[(o >> 8) & 7], ~(o & 255) >>> 0, 1);
        break;
      case ANDS:
        r = R[o & 7] & R[(o >> 3) & 7];
        R[o & 7] = r;
        nz(r);
        break;
      case EORS:
        r = R[o & 7] ^ R[(o >> 3) & 7];
        R[o & 7] = r;
        nz(r);
        break;
      case LSLR: {
        const n = R[(o >> 3) & 7] & 255,
          v = R[o & 7];
        if (n === 0) r = v;
        else if (n < 32) {
          r = v << n;
          core.C = ((v >>> (32 - n)) & 1) === 1;
        } else {
          r = 0;
          core.C = n === 32 ? (v & 1) === 1 : false;
        }
        R[o & 7] = r;
        nz(r | 0);
        break;
      }
      case LSRR: {
        const n = R[(o >> 3) & 7] & 255,
          v = R[o & 7];
        if (n === 0) r = v;
        else if (n < 32) {
          r = v >>> n;
          core.C = ((v >>> (n - 1)) & 1) === 1;
        } else {
          r = 0;
          core.C = n === 32 ? v > 0x7fffffff : false;
        }
        R[o & 7] = r;
        nz(r | 0);
        break;
      }
      case ASRR: {
        const n = R[(o >> 3) & 7] & 255,
          v = R[o & 7] | 0;
        if (n === 0) r = v;
        else if (n < 32) {
          r = v >> n;
          core.C = ((v >> (n - 1)) & 1) === 1;
        } else {
          r = v >> 31;
          core.C = v < 0;
        }
        R[o & 7] = r;
        nz(r);
        break;
      }
      case ADCS:
        R[o & 7] = add(R[o & 7], R[(o >> 3) & 7], core.C ? 1 : 0);
        break;
      case SBCS:
        R[o & 7] = add(R[o & 7], ~R[(o >> 3) & 7] >>> 0, core.C ? 1 : 0);
        break;
      case TST:
        nz(R[o & 7] & R[(o >> 3) & 7]);
        break;
      case RSBS:
        R[o & 7] = add(0, ~R[(o >> 3) & 7] >>> 0, 1);
        break;
      case CMPR:
        add(R[o & 7], ~R[(o >> 3) & 7] >>> 0, 1);
        break;
      case CMN:
        add(R[o & 7], R[(o >> 3) & 7], 0);
        break;
      case ORRS:
        r = R[o & 7] | R[(o >> 3) & 7];
        R[o & 7] = r;
        nz(r);
        break;
      case MULS:
        r = Math.imul(R[o & 7], R[(o >> 3) & 7]);
        R[o & 7] = r;
        nz(r);
        break;
      case BICS:
        r = R[o & 7] & ~R[(o >> 3) & 7];
        R[o & 7] = r;
        nz(r);
        break;
      case MVNS:
        r = ~R[(o >> 3) & 7];
        R[o & 7] = r;
        nz(r);
        break;
      case HADD: {
        const m = (o >> 3) & 15,
          d = ((o >> 4) & 8) | (o & 7);
        const v = (d === 15 ? pc + 4 : R[d]) + (m === 15 ? pc + 4 : R[m]);
        if (d === 15) {
          np = v & ~1;
          c = 2;
        } else if (d === 13) R[13] = v & ~3;
        else R[d] = v;
        break;
      }
      case HCMP:
        add(R[((o >> 4) & 8) | (o & 7)], ~R[(o >> 3) & 15] >>> 0, 1);
        break;
      case HMOV: {
        const m = (o >> 3) & 15,
          d = ((o >> 4) & 8) | (o & 7);
        const v = m === 15 ? pc + 4 : R[m];
        if (d === 15) {
          np = v & ~1;
          c = 2;
        } else if (d === 13) R[13] = v & ~3;
        else R[d] = v;
        break;
      }
      case BX: {
        const a = R[(o >> 3) & 15];
        R[15] = np;
        core.BXWritePC(a);
        return extra + (a >>> 28 === 15 ? 14 : 2);
      }
      case BLX: {
        const a = R[(o >> 3) & 15];
        R[14] = np | 1;
        np = a & ~1;
        c = 2;
        break;
      }
      case LDRL: {
        const a = ((pc + 4) & ~3) + ((o & 255) << 2);
        R[(o >> 8) & 7] = core.readUint32(a);
        c = 2;
        break;
      }
      case STRR: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 1);
        core.writeUint32(a, R[o & 7]);
        break;
      }
      case STRHR: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 1);
        core.writeUint16(a, R[o & 7] & 0xffff);
        break;
      }
      case STRBR: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 1);
        core.writeUint8(a, R[o & 7] & 0xff);
        break;
      }
      case LDRSB: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 0);
        R[o & 7] = (core.readUint8(a) << 24) >> 24;
        break;
      }
      case LDRR: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 0);
        R[o & 7] = core.readUint32(a);
        break;
      }
      case LDRHR: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 0);
        R[o & 7] = core.readUint16(a);
        break;
      }
      case LDRBR: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 0);
        R[o & 7] = core.readUint8(a);
        break;
      }
      case LDRSH: {
        const a = (R[(o >> 3) & 7] + R[(o >> 6) & 7]) >>> 0;
        c = io(a, 0);
        R[o & 7] = (core.readUint16(a) << 16) >> 16;
        break;
      }
      case STRI: {
        const a = R[(o >> 3) & 7] + ((o >> 4) & 124);
        c = io(a, 1);
        core.writeUint32(a, R[o & 7]);
        break;
      }
      case LDRI: {
        const a = R[(o >> 3) & 7] + ((o >> 4) & 124);
        c = io(a, 0);
        R[o & 7] = core.readUint32(a);
        break;
      }
      case STRBI: {
        const a = R[(o >> 3) & 7] + ((o >> 6) & 31);
        c = io(a, 1);
        core.writeUint8(a, R[o & 7] & 0xff);
        break;
      }
      case LDRBI: {
        const a = R[(o >> 3) & 7] + ((o >> 6) & 31);
        c = io(a, 0);
        R[o & 7] = core.readUint8(a);
        break;
      }
      case STRHI: {
        const a = R[(o >> 3) & 7] + ((o >> 5) & 62);
        c = io(a, 1);
        core.writeUint16(a, R[o & 7] & 0xffff);
        break;
      }
      case LDRHI: {
        const a = R[(o >> 3) & 7] + ((o >> 5) & 62);
        c = io(a, 0);
        R[o & 7] = core.readUint16(a);
        break;
      }
      case STRSP:
        core.writeUint32(R[13] + ((o & 255) << 2), R[(o >> 8) & 7]);
        c = 2;
        break;
      case LDRSP:
        R[(o >> 8) & 7] = core.readUint32(R[13] + ((o & 255) << 2));
        c = 2;
        break;
      case ADR:
        R[(o >> 8) & 7] = ((pc + 4) & ~3) + ((o & 255) << 2);
        break;
      case ADDSPR:
        R[(o >> 8) & 7] = R[13] + ((o & 255) << 2);
        break;
      case ADDSP:
        R[13] += (o & 127) << 2;
        break;
      case SUBSP:
        R[13] -= (o & 127) << 2;
        break;
      case SXTH:
        R[o & 7] = (R[(o >> 3) & 7] << 16) >> 16;
        break;
      case SXTB:
        R[o & 7] = (R[(o >> 3) & 7] << 24) >> 24;
        break;
      case UXTH:
        R[o & 7] = R[(o >> 3) & 7] & 0xffff;
        break;
      case UXTB:
        R[o & 7] = R[(o >> 3) & 7] & 0xff;
        break;
      case PUSH: {
        const n = bits[o & 0x1ff];
        let a = R[13] - 4 * n;
        R[13] = a;
        for (let i = 0; i < 8; i++)
          if (o & (1 << i)) {
            core.writeUint32(a, R[i]);
            a += 4;
          }
        if (o & 256) core.writeUint32(a, R[14]);
        c = 1 + n;
        break;
      }
      case POP: {
        const n = bits[o & 0x1ff];
        let a = R[13];
        for (let i = 0; i < 8; i++)
          if (o & (1 << i)) {
            R[i] = core.readUint32(a);
            a += 4;
          }
        if (o & 256) {
          const t = core.readUint32(a);
          R[13] = a + 4;
          R[15] = np;
          core.BXWritePC(t);
          return extra + 3 + n + (t >>> 28 === 15 ? 12 : 0);
        }
        R[13] = a;
        c = 1 + n;
        break;
      }
      case LDM: {
        const n = (o >> 8) & 7;
        let a = R[n];
        for (let i = 0; i < 8; i++)
          if (o & (1 << i)) {
            R[i] = core.readUint32(a);
            a += 4;
          }
        if (!(o & (1 << n))) R[n] = a;
        c = 1 + bits[o & 255];
        break;
      }
      case STM: {
        const n = (o >> 8) & 7;
        let a = R[n];
        for (let i = 0; i < 8; i++)
          if (o & (1 << i)) {
            core.writeUint32(a, R[i]);
            a += 4;
          }
        R[n] = a;
        c = 1 + bits[o & 255];
        break;
      }
      case BCC: {
        let t;
        const cc = (o >> 8) & 15;
        switch (cc >> 1) {
          case 0:
            t = core.Z;
            break;
          case 1:
            t = core.C;
            break;
          case 2:
            t = core.N;
            break;
          case 3:
            t = core.V;
            break;
          case 4:
            t = core.C && !core.Z;
            break;
          case 5:
            t = core.N === core.V;
            break;
          default:
            t = core.N === core.V && !core.Z;
        }
        if (cc & 1 ? !t : t) {
          np = pc + 4 + (((o & 255) << 24) >> 23);
          c = 2;
        }
        break;
      }
      case B:
        np = pc + 4 + (((o & 0x7ff) << 21) >> 20);
        c = 2;
        break;
      case BL: {
        const o2 = core.readUint16(pc + 2);
        if ((o2 & 0xd000) !== 0xd000) return core.executeInstruction() + extra;
        const S = (o >> 10) & 1,
          I1 = 1 - (S ^ ((o2 >> 13) & 1)),
          I2 = 1 - (S ^ ((o2 >> 11) & 1));
        const imm =
          (S ? 0xff000000 : 0) |
          (I1 << 23) |
          (I2 << 22) |
          ((o & 0x3ff) << 12) |
          ((o2 & 0x7ff) << 1);
        R[14] = (pc + 4) | 1;
        np = pc + 4 + imm;
        c = 3;
        break;
      }
      case NOP:
        break;
    }
    R[15] = np;
    return c + extra;
  };
}
