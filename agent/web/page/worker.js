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
  async begin({ world, options, number: begun }) {
    number = begun;
    const { wasm, image, layout, facts } = worlds[world];
    episode = worlds[world].episode ??= new Episode(await inflated(wasm), await inflated(image), layout, facts);
    episode.begin(options);
    post("begun", { frames: [episode.still()], downhill: episode.downhill() });
  },
  load(data) {
    worlds.push(...data.worlds);
  },
  step() {
    if (episode.outcome) return;
    const began = performance.now(), before = episode.time, frames = episode.step();
    post("step", { frames, rate: (1000 * (episode.time - before)) / (performance.now() - began) });
  },
  place({ robot, x, y }) {
    if (!episode.outcome && episode.place(robot, x, y)) post("placed", { frames: [episode.still()] });
  },
  // A whole episode as fast as it goes, with the positions at the end of every RL step.
  record() {
    const positions = [], began = performance.now();
    while (!episode.outcome) {
      episode.step();
      const { values, shape } = episode.machine.array("play.state.bodies");
      positions.push(episode.robots.map((robot) => [0, 1, 2].map((axis) => values[axis * shape[1] + robot])));
    }
    const { outcome, time, paths } = episode;
    post("recorded", { outcome, time, paths, positions, wall_s: (performance.now() - began) / 1000 });
  },
};

let last = Promise.resolve(); // one after the other
onmessage = ({ data }) => {
  last = last.then(() => actions[data.action](data)).catch((error) => postMessage({ kind: "error", text: String(error.message ?? error) }));
};
