// The host at the other end of the UART: frames, requests, replies, events and telemetry.
const KIND = { request: 0x51, reply: 0x52, telemetry: 0x54, inputs: 0x58 };
const SESSION = 48211; // five digits, as all that rigs/devices/valve_controller.py draws

const CRC_TABLE = Array.from({ length: 256 }, (_, high) => {
  let crc = high << 8;
  for (let bit = 0; bit < 8; bit++) crc = ((crc << 1) ^ (crc & 0x8000 ? 0x1021 : 0)) & 0xffff;
  return crc;
});

function crc16(data) {
  let crc = 0xffff;
  for (const byte of data) crc = ((crc << 8) & 0xff00) ^ CRC_TABLE[(crc >> 8) ^ byte];
  return crc;
}

/** Bytes without a zero (COBS), and a zero at the end. */
function encoded(payload) {
  const crc = crc16(payload);
  const out = [0];
  let code = 0;
  for (const byte of [...payload, crc >> 8, crc & 255, 0]) {
    if (byte === 0) {
      out[code] = out.length - code;
      code = out.length;
      out.push(0);
    } else out.push(byte); // requests are shorter than a block of 254
  }
  return out;
}

/** The payload of a frame without its zero; null if it is damaged. */
function decoded(frame) {
  const out = [];
  for (let at = 0; at < frame.length;) {
    const code = frame[at];
    for (let k = 1; k < code; k++) out.push(frame[at + k]);
    at += code;
    if (code < 255 && at < frame.length) out.push(0);
  }
  const crc = out.length > 2 ? crc16(out.slice(0, -2)) : -1;
  if (crc !== ((out.at(-2) << 8) | out.at(-1))) return null;
  return Buffer.from(out.slice(0, -2));
}

export class Host {
  /** `guarded`: the verbs that name the session, valvefw.wire.GUARDED and `arm`. */
  constructor(board, guarded) {
    this.board = board;
    this.guarded = new Set([...guarded, "arm"]);
    this.part = [];
    this.damaged = 0;
    this.events = []; // [ns, text]
    this.replies = new Map();
    this.pending = new Map(); // request id: [verb, ns]
    this.trips = []; // [verb, ns from the first byte of the request to the last of the reply]
    this.errors = []; // replies that refuse
    this.next = -1; // number of the next sample
    this.gaps = 0;
    this.samples = 0;
    this.inputs = {}; // readings of the further inputs by "input:state"
    this.id = 0;
    this.beats = 0;
    board.uart.onByte = (byte) => this.#byte(byte);
  }

  #byte(byte) {
    if (byte) {
      this.part.push(byte);
      return;
    }
    if (!this.part.length) return;
    const payload = decoded(this.part);
    this.part = [];
    if (payload === null) this.damaged++;
    else if (payload[0] === KIND.telemetry) this.#telemetry(payload);
    else if (payload[0] === KIND.inputs) this.#inputs(payload);
    else if (payload[0] === KIND.reply) this.#reply(payload.subarray(1).toString());
    else this.events.push([this.board.nanos, payload.subarray(1).toString()]);
  }

  #inputs(payload) {
    for (let at = 8; at < payload.length; at += 9) {
      const tag = payload[at + 4];
      const name = `${tag & 15}:${tag >> 4}`;
      this.inputs[name] = (this.inputs[name] ?? 0) + 1;
    }
  }

  #telemetry(payload) {
    const number = payload.readUInt32LE(5);
    if (this.next >= 0 && number !== this.next) this.gaps++;
    this.next = number + payload[13];
    this.samples += payload[13];
  }

  #reply(text) {
    const id = Number(text.split(" ", 1)[0]);
    this.replies.set(id, text.slice(text.indexOf(" ") + 1));
    const sent = this.pending.get(id);
    if (sent) this.trips.push([sent[0], this.board.nanos - sent[1]]);
    this.pending.delete(id);
    if (/^\d+ err /.test(text)) this.errors.push(text);
  }

  /** Send a request; `done` is called when its last byte has arrived. Returns its id. */
  send(text, done) {
    this.id = (this.id % 60000) + 1;
    const [verb] = text.split(" ", 1);
    this.pending.set(this.id, [verb, this.board.nanos]);
    const marked = this.guarded.has(verb) ? `${text} @${SESSION}` : text;
    const bytes = encoded([KIND.request, ...Buffer.from(`${this.id} ${marked}`)]);
    this.board.uart.send(bytes, done);
    return this.id;
  }

  beat(done) {
    this.beats = (this.beats + 1) % 65536;
    return this.send(`hb ${this.beats}`, done);
  }

  /** Run for so many milliseconds, or until `stop`. */
  wait(ms, stop) {
    this.board.run(this.board.nanos + ms * 1e6, stop);
  }

  /** Run with heartbeats. */
  keep(ms) {
    const end = this.board.nanos + ms * 1e6;
    let beatAt = this.board.nanos;
    while (this.board.nanos < end) {
      if (this.board.nanos >= beatAt) {
        this.beat();
        beatAt += 100e6;
      }
      this.board.run(Math.min(end, beatAt));
    }
  }

  /** One request and its reply. */
  ask(text, ms = 300) {
    const id = this.send(text);
    this.wait(ms, () => this.replies.has(id));
    const reply = this.replies.get(id);
    if (reply === undefined) throw new Error(`no reply to ${text}`);
    return reply;
  }

  /** A request that must succeed. */
  must(text, ms) {
    const reply = this.ask(text, ms);
    if (!/^ok/.test(reply)) throw new Error(`${text}: ${reply}`);
    return reply;
  }

  /** Wait for the board to start and vent; read what arming needs. */
  boot() {
    const { board } = this;
    const seen = (word) => this.events.some((event) => event[1].startsWith(word));
    this.wait(5000, () => seen("boot"));
    if (!seen("boot")) throw new Error("no boot event within 5 s");
    this.bootMs = board.nanos / 1e6;
    board.uart.send([0]);
    this.wait(3000, () => seen("vented"));
    const ident = this.must("id");
    [, this.bootId] = ident.match(/boot=(\d+)/);
    [, this.conf] = ident.match(/conf=([0-9a-f]+)/);
    return ident;
  }

  /** Set parameters; arming then states their new CRC. */
  set(requests) {
    for (const text of requests) [, this.conf] = this.must(text).match(/conf=([0-9a-f]+)/);
  }

  arm() {
    this.must(`arm ${this.conf} ${this.bootId}`, 1000);
    this.beat();
  }

  /** Start a scheme, as a user of it would. */
  start(scheme) {
    this.must(`scheme ${scheme}`);
    if (scheme === "open") this.must("pulse inlet 12345 5 40000");
    else if (scheme !== "idle") this.must("sp 16000");
  }
}

export { figuresOfTrips };

/** Round-trip times in ms by verb. */
function figuresOfTrips(trips, figures) {
  const byVerb = new Map();
  for (const [verb, ns] of trips) byVerb.set(verb, [...(byVerb.get(verb) ?? []), ns / 1e6]);
  return Object.fromEntries([...byVerb].map(([verb, values]) => [verb, figures(values)]));
}
