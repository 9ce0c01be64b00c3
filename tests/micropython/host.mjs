// A MicroPython interpreter with the firmware's source in its file system.
// One JSON string of Python per line in; one JSON object a line out: {"out": printed} or {"error"}.
import fs from "node:fs";
import path from "node:path";
import readline from "node:readline";
import { loadMicroPython } from "@micropython/micropython-webassembly-pyscript";

let printed = "";
const mp = await loadMicroPython({
  heapsize: 2 * 1024 * 1024,
  linebuffer: false,
  stdout: (bytes) => {
    printed += typeof bytes === "string" ? bytes : Buffer.from(bytes).toString("utf8");
  },
});
mp.FS.mkdir("/valvefw");
for (const name of fs.readdirSync(process.argv[2])) {
  if (name.endsWith(".py")) {
    mp.FS.writeFile("/valvefw/" + name, fs.readFileSync(path.join(process.argv[2], name)));
  }
}
mp.runPython("import sys; sys.path.append('/')");
for await (const line of readline.createInterface({ input: process.stdin })) {
  printed = "";
  let answer;
  try {
    mp.runPython(JSON.parse(line));
    answer = { out: printed };
  } catch (error) {
    answer = { error: String(error), out: printed };
  }
  process.stdout.write(JSON.stringify(answer) + "\n");
}
