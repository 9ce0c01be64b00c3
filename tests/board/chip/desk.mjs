// The firmware's simulated board under the emulated chip's MicroPython: the conversations of the
// job once more, and every byte compared. UART1 carries them (board/on_chip.py).
import { Board } from "./board.mjs";
import { rounded } from "./figures.mjs";

const PIECE_MS = 25; // of a longer run: the answer of one piece fits into the chip's memory
const MOST_BYTES = 256; // of a request; more go in pieces of their own, with no time between

export function desk(job, tell) {
  const board = new Board(job);
  let received = [];
  board.desk.onByte = (byte) => received.push(byte);
  const wait = (bytes, what) => {
    const until = board.nanos + 20e9;
    board.run(until, () => received.length >= bytes);
    if (received.length < bytes) throw new Error(`${what}: no answer from the script on the board`);
  };
  wait(1, "start");
  received = [];

  /** One exchange: command, milliseconds, bytes; the answer. */
  const exchange = (command, ms, data) => {
    board.desk.send([command, ms, data.length & 255, data.length >> 8, ...data]);
    wait(2, "length");
    const length = received[0] | (received[1] << 8);
    wait(2 + length, "answer");
    const out = Buffer.from(received.slice(2, 2 + length));
    received = [];
    return out;
  };

  const wrong = [];
  let bytes = 0;
  let ticks = 0;
  let toldAt = Date.now();
  for (const [k, conversation] of job.conversations.entries()) {
    exchange(0, 0, [conversation.boot & 255, conversation.boot >> 8]);
    for (const [at, [hex, ms, expected]] of conversation.calls.entries()) {
      const parts = [];
      let data = Buffer.from(hex, "hex");
      while (data.length > MOST_BYTES) {
        parts.push(exchange(1, 0, data.subarray(0, MOST_BYTES)));
        data = data.subarray(MOST_BYTES);
      }
      for (let left = ms; left > 0 || data.length; left -= PIECE_MS) {
        parts.push(exchange(1, Math.max(0, Math.min(left, PIECE_MS)), data));
        data = Buffer.alloc(0);
      }
      const out = Buffer.concat(parts);
      bytes += out.length;
      ticks += ms;
      if (out.toString("hex") !== expected) {
        wrong.push({
          conversation: conversation.name,
          call: at,
          got: out.toString("hex"),
          expected,
        });
        break; // what follows would differ as well
      }
    }
    if (Date.now() - toldAt > 10000) {
      toldAt = Date.now();
      tell(`${k + 1} of ${job.conversations.length} conversations, ${ticks} ms`);
    }
  }
  return {
    conversations: job.conversations.length,
    bytes,
    ticks,
    wrong,
    seconds: rounded(board.nanos / 1e9),
  };
}
