// Day and night. Day is made for the sun: dark ink on a pale sea. Night keeps the eyes adapted: dim, and no white.

import { Stroke, Style } from "ol/style";

export type Theme = "day" | "night";

export interface Palette {
  ink: string;
  soft: string;
  halo: string;
  sea: string;
  land: string;
  line: string;
  accent: string;
  plan: string; // the mission aboard
  draft: string; // a plan that is on the screen only
  steer: string; // where it is steering
  danger: string;
  dangerFill: string;
  survey: string; // areas and lines of a survey
  done: string; // lines that were sailed
  handle: string;
  port: string;
  starboard: string;
  chart: number; // opacity of the background
  depths: string[]; // of official charts: shallow to deep
  forbidden: string; // water that an official chart forbids
}

const DAY: Palette = {
  ink: "#0d2230",
  soft: "#4d6472",
  halo: "rgba(255,255,255,.85)",
  sea: "#e4edf1",
  land: "#d8d1bd",
  line: "rgba(30,70,92,.22)",
  accent: "#0a5fa8",
  plan: "#0a5fa8",
  draft: "#a85f00",
  steer: "#a3148c",
  danger: "#b4232f",
  dangerFill: "rgba(180,35,47,.14)",
  survey: "#00707f",
  done: "#0f7a4d",
  handle: "#ffffff",
  port: "#b02a37",
  starboard: "#0f7a4d",
  chart: 1,
  depths: ["#9cc3de", "#b9d6e8", "#d2e5f0", "#e6f1f6"],
  forbidden: "rgba(180,35,47,.24)",
};

const NIGHT: Palette = {
  ink: "#c3cfd4",
  soft: "#7d919b",
  halo: "rgba(5,14,20,.85)",
  sea: "#07141c",
  land: "#1d2524",
  line: "rgba(140,180,200,.16)",
  accent: "#5c9ccc",
  plan: "#5c9ccc",
  draft: "#d09a4a",
  steer: "#c878c0",
  danger: "#d0525a",
  dangerFill: "rgba(208,82,90,.14)",
  survey: "#3fa7b5",
  done: "#4f9e78",
  handle: "#0c1c26",
  port: "#c8646c",
  starboard: "#4f9e78",
  chart: 0.2,
  depths: ["#1c4259", "#153548", "#0f2838", "#0a1d28"],
  forbidden: "rgba(208,82,90,.22)",
};

const KEPT = "delfim.theme";

export let theme: Theme = (localStorage.getItem(KEPT) as Theme | null) ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "night" : "day");
export let palette = theme === "day" ? DAY : NIGHT;
document.documentElement.dataset["theme"] = theme;

export function setTheme(next: Theme): void {
  theme = next;
  palette = next === "day" ? DAY : NIGHT;
  localStorage.setItem(KEPT, next);
  document.documentElement.dataset["theme"] = next;
}

function channels(colour: string): [number, number, number] {
  const found = colour.match(/^#?([0-9a-f]{6})$/i);
  const value = Number.parseInt(found ? found[1]! : "8aa0ab", 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
}

/** A boat's colour as a line that is seen on the sea of the day, or of the night. */
export function inked(colour: string, alpha = 1): string {
  const rgb = channels(colour);
  const light = (0.299 * rgb[0] + 0.587 * rgb[1] + 0.114 * rgb[2]) / 255;
  const factor = theme === "day" ? Math.min(1, 0.5 / Math.max(light, 0.01)) : Math.min(1, 0.72 / Math.max(light, 0.01));
  return `rgba(${rgb.map((each) => Math.round(each * factor)).join(",")},${alpha})`;
}

/** A line that is seen on any chart: its colour over a halo. */
export function cased(color: string, width: number, lineDash?: number[]): Style[] {
  const stroke = (tint: string, wide: number) =>
    new Style({ stroke: new Stroke({ color: tint, width: wide, lineCap: lineDash ? "butt" : "round", ...(lineDash ? { lineDash } : {}) }) });
  return [stroke(palette.halo, width + 2.4), stroke(color, width)];
}
