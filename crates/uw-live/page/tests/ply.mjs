// Points of a PLY file: text or little-endian.

const SIZES = { char: 1, uchar: 1, int8: 1, uint8: 1, short: 2, ushort: 2, int16: 2, uint16: 2, int: 4, uint: 4, int32: 4, uint32: 4, float: 4, float32: 4, double: 8, float64: 8 };
const READ = { 4: "readFloatLE", 8: "readDoubleLE" };

/** Number of points and their x, y, z one after another, mm. */
export function readPly(bytes) {
  const end = bytes.indexOf("end_header\n") + "end_header\n".length;
  const lines = bytes.subarray(0, end).toString("latin1").split("\n");
  const format = lines.find((line) => line.startsWith("format ")).split(" ")[1];
  const from = lines.findIndex((line) => line.startsWith("element vertex "));
  const count = Number(lines[from].split(" ")[2]);
  const properties = [];
  for (let i = from + 1; lines[i].startsWith("property ") || lines[i].startsWith("comment "); i++) {
    const [word, type, name] = lines[i].split(" ");
    if (word === "property") properties.push({ type, name });
  }
  const positions = [];
  if (format === "ascii") {
    const rows = bytes.subarray(end).toString("latin1").split("\n");
    const columns = ["x", "y", "z"].map((axis) => properties.findIndex(({ name }) => name === axis));
    for (let i = 0; i < count; i++) { const row = rows[i].trim().split(/\s+/); columns.forEach((c) => positions.push(Number(row[c]))); }
  } else if (format === "binary_little_endian") {
    const stride = properties.reduce((sum, { type }) => sum + SIZES[type], 0);
    let at = 0;
    const places = {};
    for (const { type, name } of properties) { places[name] = [at, SIZES[type]]; at += SIZES[type]; }
    for (let i = 0; i < count; i++) for (const axis of ["x", "y", "z"]) positions.push(bytes[READ[places[axis][1]]](end + stride * i + places[axis][0]));
  } else {
    throw new Error(`a PLY file of format ${format} is not read here`);
  }
  return { count, positions };
}
