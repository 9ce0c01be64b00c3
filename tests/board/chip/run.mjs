// node run.mjs < job.json: one part of the test on one emulated board. Progress goes to standard
// error, the result as one line of JSON to standard output.
import fs from "node:fs";

const job = JSON.parse(fs.readFileSync(0, "utf8"));
const modules = {
  scheme: () => import("./scheme.mjs"),
  trials: () => import("./trials.mjs"),
  pulses: () => import("./pulses.mjs"),
  memory: () => import("./memory.mjs"),
  desk: () => import("./desk.mjs"),
};
const began = Date.now();
const module = await modules[job.kind]();
const result = module[job.kind](job, (text) => process.stderr.write(`${text}\n`));
result.took_s = Math.round((Date.now() - began) / 100) / 10;
process.stdout.write(`${JSON.stringify(result)}\n`);
