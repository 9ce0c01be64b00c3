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
function put(from, to) {
  mp.FS.mkdir(to);
  for (const entry of fs.readdirSync(from, { withFileTypes: true })) {
    if (entry.isDirectory() && entry.name !== "__pycache__") {
      put(path.join(from, entry.name), to + "/" + entry.name);
    } else if (entry.name.endsWith(".py")) {
      // This interpreter has no machine code and refuses its decorator.
      const text = fs.readFileSync(path.join(from, entry.name), "utf8");
      mp.FS.writeFile(to + "/" + entry.name, text.replace(/^ *@micropython\.(viper|native)$/gm, ""));
    }
  }
}
put(process.argv[2], "/valvefw");
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
