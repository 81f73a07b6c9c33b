// The data of the page.
const REPORT = JSON.parse(document.getElementById("report-data").textContent);

// Columns are packed as base64 of little-endian numbers, and unpacked when they are needed.
const ARRAYS = { f32: Float32Array, f64: Float64Array, u32: Uint32Array, u8: Uint8Array };

const unpack = ({ type, data }) => {
  const bytes = Uint8Array.from(atob(data), (character) => character.charCodeAt(0));
  return new ARRAYS[type](bytes.buffer);
};

const isPacked = (value) => value !== null && typeof value === "object" && "data" in value;

const unpackAll = (columns) =>
  Object.fromEntries(Object.entries(columns).map(([name, value]) => [name, isPacked(value) ? unpack(value) : value]));

// Caches the results of a function by its argument.
const remember = (make) => {
  const made = new Map();
  return (key) => {
    if (!made.has(key)) made.set(key, make(key));
    return made.get(key);
  };
};
