// The colours of the map, which are those of the page: tokens.css has them, in four themes.

import { Fill, Stroke, Style } from "ol/style";

export const THEMES = ["bright", "day", "dusk", "night"] as const;
export type Theme = (typeof THEMES)[number];

export const FACE = "B612, system-ui, sans-serif";
const KEPT = "delfim.theme";
const NAMES = [
  "ink",
  "soft",
  "halo",
  "sea",
  "land",
  "line", // of the graticule
  "accent",
  "plan", // the mission aboard
  "draft", // a plan that is on the screen only
  "steer", // where it is steering
  "survey", // areas and lines of a survey
  "done", // lines that were sailed
  "limit", // fences, obstacles, water that a chart forbids
  "limitback",
  "forbidden",
  "bad", // of an alert
  "danger", // the domain of a vessel that comes too near
  "handle",
  "hull", // around a boat
] as const;

export type Palette = Record<(typeof NAMES)[number], string> & {
  chart: number; // opacity of the background
  brightness: number; // the most that a boat's line has
  depths: string[]; // of official charts: shallow to deep
};

export let theme: Theme = kept() ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "night" : "day");
document.documentElement.dataset["theme"] = theme;
export let palette = read();

export function setTheme(next: Theme): void {
  theme = next;
  localStorage.setItem(KEPT, next);
  document.documentElement.dataset["theme"] = next;
  palette = read();
}

function kept(): Theme | undefined {
  return THEMES.find((each) => each === localStorage.getItem(KEPT));
}

function read(): Palette {
  const style = getComputedStyle(document.documentElement);
  const token = (name: string) => style.getPropertyValue(`--${name}`).trim();
  const colours = Object.fromEntries(NAMES.map((name) => [name, token(name)])) as Record<(typeof NAMES)[number], string>;
  return { ...colours, chart: Number(token("chart")), brightness: Number(token("brightness")), depths: [1, 2, 3, 4].map((each) => token(`depth${each}`)) };
}

function channels(colour: string): [number, number, number] {
  const found = colour.match(/^#?([0-9a-f]{6})$/i);
  const value = Number.parseInt(found ? found[1]! : "8aa0ab", 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

/** A boat's colour as a line that is seen on the sea of this theme: dark ones become grey in the dark. */
export function inked(colour: string, alpha = 1): string {
  const rgb = channels(colour);
  const light = (0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]) / 255;
  const isDark = palette.brightness > 0.5;
  const factor = Math.min(1, palette.brightness / Math.max(light, 0.01));
  const lift = isDark ? Math.max(0, 90 - 255 * light) : 0;
  return `rgba(${rgb.map((each) => Math.min(255, Math.round(each * factor + lift))).join(",")},${alpha})`;
}

/** Words that are read on that colour. */
export function over(colour: string): string {
  const [red, green, blue] = channels(colour);
  return 0.299 * red + 0.587 * green + 0.114 * blue > 130 ? "#000000" : "#ffffff";
}

/** A line that is seen on any chart: its colour over a halo. */
export function cased(color: string, width: number, lineDash?: number[]): Style[] {
  const stroke = (tint: string, wide: number) =>
    new Style({ stroke: new Stroke({ color: tint, width: wide, lineCap: lineDash ? "butt" : "round", ...(lineDash ? { lineDash } : {}) }) });
  return [stroke(palette.halo, width + 2.4), stroke(color, width)];
}

/** What lies behind words: a plate on photographs and charts, a halo on the bare sea. */
export function onPlate(plate: boolean, width: number): { backgroundFill?: Fill; padding?: number[]; stroke?: Stroke } {
  return plate ? { backgroundFill: new Fill({ color: palette.halo }), padding: [2, 4, 1, 4] } : { stroke: new Stroke({ color: palette.halo, width }) };
}
