/** Colours of sessions, classes and scales. */

export type Rgb = [number, number, number];

/** Robots, in the order in which they were chosen; told apart also by people who see few colours (Okabe and Ito 2008). */
export const SESSION_COLOURS = ['#0f8bd6', '#e69f00', '#00a878', '#cc5fa0', '#d55e00', '#7d6fd0'] as const;

const CLASS_COLOURS: Record<string, string> = {
  unknown: '#8a94a3', table: '#d08a2e', chair: '#3f8fd9', shelf: '#9a6ad6', box: '#c9a227', cylinder: '#2fa58d', person: '#e0526a',
  car: '#3f8fd9', van: '#5b7fe0', truck: '#9a6ad6', bus: '#c9722e', cyclist: '#2fa58d', motorcycle: '#8fae2e',
};

/** A class that has no colour of its own gets one by its name, the same each time. */
export function classColour(label: string): string {
  const known = CLASS_COLOURS[label];
  if (known) return known;
  let hash = 0;
  for (const letter of label) hash = (hash * 31 + letter.charCodeAt(0)) >>> 0;
  return `hsl(${hash % 360} 55% 55%)`;
}

export const LOOP_COLOURS: Record<string, string> = {
  LOOP_STATE_ACTIVE: '#21a366', LOOP_STATE_PENDING: '#e0a020', LOOP_STATE_REJECTED: '#8a94a3', LOOP_STATE_VETOED: '#d8433b',
};

// Turbo's hues without its dark ends, which vanish on a dark ground or a light one.
const RAMP: Rgb[] = [[70, 92, 214], [36, 150, 230], [26, 190, 180], [90, 205, 100], [190, 205, 55], [242, 170, 50], [234, 100, 45], [200, 50, 50]];

/** A colour of the scale, 0 to 1. */
export function ramp(share: number): Rgb {
  const at = Math.min(1, Math.max(0, share)) * (RAMP.length - 1);
  const low = RAMP[Math.floor(at)]!, high = RAMP[Math.ceil(at)]!, part = at % 1;
  return [0, 1, 2].map(i => Math.round(low[i]! + (high[i]! - low[i]!) * part)) as Rgb;
}

/** The scale as CSS draws it, from left to right. */
export const RAMP_CSS = `linear-gradient(to right, ${RAMP.map(c => `rgb(${c.join()})`).join()})`;

/** #rrggbb or hsl() as three numbers. */
export function rgb(colour: string): Rgb {
  const hex = /^#(..)(..)(..)$/.exec(colour);
  if (hex) return [hex[1], hex[2], hex[3]].map(part => parseInt(part!, 16)) as Rgb;
  const hsl = /^hsl\(([\d.]+) ([\d.]+)% ([\d.]+)%\)$/.exec(colour);
  if (!hsl) return [138, 148, 163];
  const [h, s, l] = [Number(hsl[1]), Number(hsl[2]) / 100, Number(hsl[3]) / 100];
  const part = (n: number): number => {
    const k = (n + h / 30) % 12;
    return Math.round(255 * (l - s * Math.min(l, 1 - l) * Math.max(-1, Math.min(k - 3, 9 - k, 1))));
  };
  return [part(0), part(8), part(4)];
}
