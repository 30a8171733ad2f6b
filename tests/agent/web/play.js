// Runs the worker of a page without a browser: node play.js PAGE OPTIONS…, each a JSON object with
// what "begin" takes, and `refused`, a place that a robot does not get after the first step; prints
// how each episode ends, a line each.
const { readFileSync } = require("node:fs");
const { runInThisContext } = require("node:vm");

const page = readFileSync(process.argv[2], "utf8");
const part = (id) => page.match(new RegExp(`id="${id}">([^]*?)</script>`))[1];
const replies = [];
let arrived;

globalThis.postMessage = (message) => {
  replies.push(message);
  arrived?.();
};

async function reply(kind) {
  for (;;) {
    const message = replies.shift();
    if (message?.kind === "error") throw new Error(message.text);
    if (message?.kind === kind) return message;
    if (!message) await new Promise((done) => (arrived = done));
  }
}

async function main() {
  runInThisContext(part("worker"));
  const data = JSON.parse(part("data"));
  onmessage({ data: { action: "load", worlds: data.worlds } });
  for (const text of process.argv.slice(3)) {
    const { world = 0, refused, ...given } = JSON.parse(text), { mu, noise, shielded } = data.worlds[world].facts;
    const options = { seed: data.seed, mu, noise, shielded, ...given };
    onmessage({ data: { action: "begin", world, options, number: 1 } });
    await reply("begun");
    if (refused) {
      onmessage({ data: { action: "step", time: 0 } });
      onmessage({ data: { action: "place", ...refused } });
      await reply("refused");
    }
    onmessage({ data: { action: "record" } });
    const { positions, outcome, time, paths, wall_s, memory } = await reply("recorded");
    console.log(JSON.stringify({ positions, outcome: data.outcomes[outcome], time, paths, wall_s, memory }));
  }
}

main();
