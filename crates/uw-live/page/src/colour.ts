// Colours that stand for numbers: the scale of the reports (cividis; Nuñez, Anderton and Renslow, PLoS ONE 13 (2018), e0199239).

export type Rgb = readonly [number, number, number];

const CIVIDIS: Rgb[] = [
  [0, 34, 78], [18, 53, 112], [59, 73, 108], [87, 93, 109], [112, 113, 115], [138, 134, 120], [165, 156, 116], [195, 179, 105], [253, 232, 55],
];

/** The colour at `share`, 0 to 1; beyond an end that end's. */
export function cividis(share: number): Rgb {
  const at = Math.max(0, Math.min(1, share)) * (CIVIDIS.length - 1);
  const below = Math.min(Math.floor(at), CIVIDIS.length - 2);
  const [a, b] = [CIVIDIS[below]!, CIVIDIS[below + 1]!];
  const mix = (k: 0 | 1 | 2) => Math.round(a[k] + (at - below) * (b[k] - a[k]));
  return [mix(0), mix(1), mix(2)];
}

/** The same without its darkest part, for points on a dark page. */
export const cividisOnDark = (share: number): Rgb => cividis(0.24 + 0.76 * share);

/** Brightness as it is, black to white, but never so dark that it is lost on a dark page. */
export function grey(share: number): Rgb {
  const value = Math.round(40 + 215 * Math.max(0, Math.min(1, share)));
  return [value, value, value];
}

/** 256 colours, RGBA. */
export function ramp(colour: (share: number) => Rgb): Uint8Array {
  const out = new Uint8Array(4 * 256);
  for (let i = 0; i < 256; i++) out.set([...colour(i / 255), 255], 4 * i);
  return out;
}
