// The values of a boat's sensors in words. Their names end with their units.
import { ageWords } from "./state";
import { speedWords } from "./units";
import type { Boat } from "./wire";

const OLD_S = 6; // a boat on a radio tells them every five seconds
const GONE_S = 60;

const NAMES: Record<string, string> = {
  awa: "apparent wind from",
  aws: "apparent wind",
  twa: "true wind from",
  tws: "true wind",
  stw: "through water",
  sigma: "position ±",
  corr: "corrections since",
  ais: "AIS",
};

const UNITS: Record<string, (value: number) => string> = {
  m: (m) => `${m.toFixed(Math.abs(m) < 1 ? 2 : 1)} m`,
  s: (s) => `${s.toFixed(0)} s`,
  mps: speedWords,
  rad: (rad) => `${((Math.round((rad * 180) / Math.PI) + 360) % 360).toFixed(0)}°`,
  pct: (pct) => `${pct.toFixed(0)} %`,
  c: (c) => `${c.toFixed(1)} °C`,
  v: (v) => `${v.toFixed(1)} V`,
  a: (a) => `${a.toFixed(1)} A`,
  ships: (ships) => `${ships} ships`,
};

/** All of them, with the ages of old ones; `more_s`: time since the boat was told of. */
export function measuredWords({ measured }: Boat, more_s: number): string {
  return Object.entries(measured ?? {})
    .filter(([, { age_s }]) => age_s + more_s <= GONE_S)
    .map(([name, { value, age_s }]) => valueWords(name, value).replaceAll(" ", "\u00a0") + (age_s + more_s > OLD_S ? ` (${ageWords(age_s + more_s)} ago)` : ""))
    .join(" · ");
}

/** A value by its name with unit, in words. */
export function valueWords(name: string, value: number): string {
  const [, stem, unit] = /^(.*)_([a-z]+)$/.exec(name) ?? ["", name, ""];
  const shown = UNITS[unit!];
  return shown ? `${NAMES[stem!] ?? stem!.replaceAll("_", " ")} ${shown(value)}` : `${name} ${Number(value.toPrecision(4))}`;
}
