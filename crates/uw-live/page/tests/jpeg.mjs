// A baseline JPEG of grey values, for the mock: ITU-T T.81 with the luminance tables of its annex K.

const ZIGZAG = [
  0, 1, 8, 16, 9, 2, 3, 10, 17, 24, 32, 25, 18, 11, 4, 5, 12, 19, 26, 33, 40, 48, 41, 34, 27, 20, 13, 6, 7, 14, 21, 28, 35, 42, 49, 56, 57, 50, 43, 36, 29,
  22, 15, 23, 30, 37, 44, 51, 58, 59, 52, 45, 38, 31, 39, 46, 53, 60, 61, 54, 47, 55, 62, 63,
];
const QUANT = [
  16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55, 14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62, 18, 22, 37, 56, 68, 109,
  103, 77, 24, 35, 55, 64, 81, 104, 113, 92, 49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99,
];
const DC_COUNTS = [0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0];
const DC_VALUES = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11];
const AC_COUNTS = [0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 125];
const AC_VALUES = Buffer.from(
  "01020300041105122131410613516107227114328191a1082342b1c11552d1f02433627282090a161718191a25262728292a3435363738393a434445464748494a535455565758595a63646566"
  + "6768696a737475767778797a838485868788898a92939495969798999aa2a3a4a5a6a7a8a9aab2b3b4b5b6b7b8b9bac2c3c4c5c6c7c8c9cad2d3d4d5d6d7d8d9dae1e2e3e4e5e6e7e8e9ea"
  + "f1f2f3f4f5f6f7f8f9fa", "hex");

function codes(counts, values) {
  const table = new Map();
  let [code, at] = [0, 0];
  counts.forEach((n, i) => {
    for (let k = 0; k < n; k++) table.set(values[at++], [code++, i + 1]);
    code <<= 1;
  });
  return table;
}
const DC = codes(DC_COUNTS, DC_VALUES);
const AC = codes(AC_COUNTS, AC_VALUES);
const COS = Array.from({ length: 64 }, (_, i) => Math.cos(((2 * (i & 7) + 1) * (i >> 3) * Math.PI) / 16) * ((i >> 3) === 0 ? Math.SQRT1_2 : 1) / 2);

/** The image as a JPEG; `quality` 1 to 100. */
export function encodeGrey(width, height, pixels, quality = 70) {
  const scale = quality < 50 ? 5000 / quality : 200 - 2 * quality;
  const quant = QUANT.map((q) => Math.max(1, Math.min(255, Math.floor((q * scale + 50) / 100))));
  const u16 = (n) => [n >> 8, n & 255];
  const segment = (marker, body) => Buffer.from([255, marker, ...u16(body.length + 2), ...body]);
  const out = [
    Buffer.from([255, 0xd8]),
    segment(0xdb, [0, ...ZIGZAG.map((at) => quant[at])]),
    segment(0xc0, [8, ...u16(height), ...u16(width), 1, 1, 0x11, 0]),
    segment(0xc4, [0, ...DC_COUNTS, ...DC_VALUES]),
    segment(0xc4, [0x10, ...AC_COUNTS, ...AC_VALUES]),
    segment(0xda, [1, 1, 0, 0, 63, 0]),
  ];
  const bytes = [];
  let [held, bits, last] = [0, 0, 0];
  const put = ([code, length]) => {
    for (let i = length - 1; i >= 0; i--) {
      held = (held << 1) | ((code >> i) & 1);
      if (++bits === 8) {
        bytes.push(held);
        if (held === 255) bytes.push(0);
        [held, bits] = [0, 0];
      }
    }
  };
  const size = (v) => 32 - Math.clz32(Math.abs(v));
  const number = (v) => [v < 0 ? v + (1 << size(v)) - 1 : v, size(v)];
  const [block, half, spread] = [new Float64Array(64), new Float64Array(64), new Int32Array(64)];
  for (let y = 0; y < height; y += 8) {
    for (let x = 0; x < width; x += 8) {
      for (let i = 0; i < 64; i++) block[i] = pixels[Math.min(height - 1, y + (i >> 3)) * width + Math.min(width - 1, x + (i & 7))] - 128;
      for (let r = 0; r < 8; r++) for (let u = 0; u < 8; u++) { let s = 0; for (let k = 0; k < 8; k++) s += block[8 * r + k] * COS[8 * u + k]; half[8 * r + u] = s; }
      for (let v = 0; v < 8; v++) for (let u = 0; u < 8; u++) { let s = 0; for (let k = 0; k < 8; k++) s += half[8 * k + u] * COS[8 * v + k]; spread[8 * v + u] = Math.round(s / quant[8 * v + u]); }
      put(DC.get(size(spread[0] - last)));
      put(number(spread[0] - last));
      last = spread[0];
      let zeros = 0;
      for (let i = 1; i < 64; i++) {
        const v = spread[ZIGZAG[i]];
        if (v === 0) { zeros++; continue; }
        for (; zeros > 15; zeros -= 16) put(AC.get(0xf0));
        put(AC.get((zeros << 4) | size(v)));
        put(number(v));
        zeros = 0;
      }
      if (zeros) put(AC.get(0));
    }
  }
  while (bits) put([1, 1]);
  return Buffer.concat([...out, Buffer.from(bytes), Buffer.from([255, 0xd9])]);
}
