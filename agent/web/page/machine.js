// A module of kernels with the memory for their arguments, see agent/web/image.py.
const VIEWS = {
  float64: Float64Array, float32: Float32Array, int64: BigInt64Array, uint64: BigUint64Array, int32: Int32Array,
  uint32: Uint32Array, int16: Int16Array, uint16: Uint16Array, int8: Int8Array, uint8: Uint8Array, bool: Uint8Array,
};

class Machine {
  // layout: of `Image`; with motors if it has the array "motors", the state of their FMU.
  constructor(wasm, image, layout) {
    const nothing = new Proxy({}, { get: () => () => 0 }); // of a system: no kernel calls it
    this.exports = new WebAssembly.Instance(new WebAssembly.Module(wasm), { wasi_snapshot_preview1: nothing }).exports;
    this.exports._initialize?.();
    Object.assign(this, { image, layout, base: this.exports.room(image.length) });
    this.reset();
  }

  // Everything as it was before the first call.
  reset() {
    const { base, exports: c, image, layout } = this;
    new Uint8Array(c.memory.buffer, base, image.length).set(image);
    const view = new DataView(c.memory.buffer, base);
    for (const at of layout.pointers) view.setInt32(at, view.getInt32(at, true) + base, true);
    if (!layout.arrays.motors) return;
    ["set_float64", "do_step", "get_float64"].forEach((name, k) => this.set(`calls.functions.${name}`, c.address_of(k)));
    const state = this.array("motors").values, motors = c.restore_motors(state.byteOffset, state.length);
    if (!motors) throw new Error("the motors refuse their state");
    this.array("calls.instances").values[0] = BigInt(motors);
  }

  // An array by its name, in memory: its view is good until memory grows, in a call.
  array(name) {
    const [at, type, shape] = this.layout.arrays[name];
    return { values: new VIEWS[type](this.exports.memory.buffer, this.base + at, shape.reduce((a, b) => a * b, 1)), shape };
  }

  // Give a number of the record another value.
  set(name, value) {
    const [at, whole] = this.layout.numbers[name], view = new DataView(this.exports.memory.buffer, this.base);
    whole ? view.setBigInt64(at, BigInt(value), true) : view.setFloat64(at, value, true);
  }

  // All that calls change.
  saved() {
    const { memory, __global_base } = this.exports;
    return new Uint8Array(memory.buffer.slice(__global_base.value));
  }

  restore(saved) {
    const { memory, __global_base } = this.exports;
    new Uint8Array(memory.buffer, __global_base.value).set(saved);
  }

  // Call a kernel; returns its whole number.
  call(kernel) {
    const result = this.exports[kernel](this.base + this.layout.record);
    if (result === -1000) throw new Error(`${kernel} failed`);
    return result;
  }
}
