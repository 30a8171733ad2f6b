// Runs an episode apart from the page, so that drawing stays smooth.
const worlds = [];
let episode, number; // of what was begun last

async function inflated(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const post = (kind, more) => postMessage({ kind, number, ...more });

const actions = {
  load: (data) => worlds.push(...data.worlds),
  async begin({ world, options, number: begun }) {
    number = begun;
    const { wasm, image, layout, facts } = worlds[world];
    episode = worlds[world].episode ??= new Episode(await inflated(wasm), await inflated(image), layout, facts);
    episode.begin(options);
    post("begun", { frames: episode.still(), downhill: episode.downhill() });
  },
  step({ time }) {
    if (episode.outcome) return;
    episode.keep(time);
    const began = performance.now(), before = episode.time, frames = episode.step();
    post("step", { frames, rate: (1000 * (episode.time - before)) / (performance.now() - began) });
  },
  place({ robot, x, y, time }) {
    if (episode.place(robot, x, y, time)) post("placed", { frames: episode.still() });
    else post("refused", { robot, x, y });
  },
  // The rest of an episode as fast as it goes, with the positions at the end of every RL step.
  record() {
    const positions = [], began = performance.now();
    while (!episode.outcome) {
      episode.step();
      const last = Number(episode.values("state.episodes.periods")[0]) - 1;
      positions.push(episode.robots.map((robot) => episode.sample("position", robot, last)));
    }
    const { outcome, time, paths, machine } = episode, memory = machine.exports.memory.buffer.byteLength;
    post("recorded", { outcome, time, paths, positions, memory, wall_s: (performance.now() - began) / 1000 });
  },
};

let last = Promise.resolve(); // one after the other
onmessage = ({ data }) => {
  const fail = (error) => postMessage({ kind: "error", text: String(error.message ?? error) });
  last = last.then(() => actions[data.action](data)).catch(fail);
};
