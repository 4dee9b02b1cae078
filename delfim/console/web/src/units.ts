// Speeds for people: metres a second, or knots where the operator has chosen them in this browser; and how far ahead all courses are drawn.

const KEPT = "delfim.knots";
const AHEAD_KEPT = "delfim.ahead";
const KNOT_MPS = 1852 / 3600;

export let inKnots = localStorage.getItem(KEPT) === "on";

export function setKnots(on: boolean): void {
  inKnots = on;
  localStorage.setItem(KEPT, on ? "on" : "off");
}

export const AHEAD_MIN = [1, 3, 6, 12];
export let ahead_min = Number(localStorage.getItem(AHEAD_KEPT) ?? 3);

/** One time for boats and vessels: where two courses end, both are at that time. */
export function setAhead(minutes: number): void {
  ahead_min = minutes;
  localStorage.setItem(AHEAD_KEPT, String(minutes));
}

export const speedUnit = (): string => (inKnots ? "kn" : "m/s");

/** The number of that unit. */
export const shownSpeed = (mps: number): number => (inKnots ? mps / KNOT_MPS : mps);

/** A number of that unit as metres a second, to the millimetre. */
export const enteredSpeed_mps = (value: number): number => Math.round(1000 * (inKnots ? value * KNOT_MPS : value)) / 1000;

export const speedWords = (mps: number): string => `${shownSpeed(mps).toFixed(1)} ${speedUnit()}`;
