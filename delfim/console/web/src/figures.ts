// The figures of the selected boat, large and in fixed places, with what is asked beside what is: a bar, a tape of the compass, and the
// two thrusters. Neutral ink: colours are for alerts.
import { attribute, hide, make, text } from "./dom";
import type { Hand } from "./drive";
import { bearing, metres } from "./geo";
import { shownSpeed, speedUnit } from "./units";
import type { Boat } from "./wire";

const SVG = "http://www.w3.org/2000/svg";
const [WIDE, HIGH] = [120, 12];
const TAPE_DEG = 60; // to either side of the bow
const STILL_MPS = 0.2; // below this speed no time to go is shown
const FULL = [1, 2, 5, 10, 20, 50]; // ends of the scale of speed

export class Figures {
  readonly root = make("div.figures");
  private readonly speed = new Figure("Speed");
  private readonly heading = new Figure("Heading");
  private readonly third = new Figure("Battery"); // or depth, where the boat measures it
  private readonly left = new Figure("To go");
  private readonly thrusters = [new Thruster("P"), new Thruster("S")] as const;
  private full = 1; // of the scale of speed

  constructor() {
    this.root.append(this.speed.root, this.heading.root, this.third.root, this.left.root, make("div.thrusters", ...this.thrusters.map((each) => each.root)));
  }

  draw(boat: Boat, hand: Readonly<Hand> | undefined): void {
    this.drawSpeed(boat);
    const turned = boat.heading_deg;
    const to = sails(boat) ? (boat.reference?.course_deg ?? boat.reference?.heading_deg ?? null) : null;
    this.heading.say(turned === null ? "–" : String(Math.round(turned) % 360).padStart(3, "0"), "°", to === null ? "" : `to ${bearing(to)}`);
    this.heading.draw(turned === null ? "" : tape(turned, to));
    this.drawThird(boat);
    this.drawLeft(boat);
    this.thrusters.forEach((each, i) => each.draw(boat.thrust_pct[i as 0 | 1], boat.rpm[i as 0 | 1], hand && (i ? hand.starboard_pct : hand.port_pct)));
  }

  private drawSpeed({ speed_mps, reference, ...boat }: Boat): void {
    const now = speed_mps === null ? null : shownSpeed(speed_mps);
    const asked = sails(boat as Boat) && reference?.speed_mps != null ? shownSpeed(reference.speed_mps) : null;
    this.full = Math.max(this.full, FULL.find((each) => each >= Math.max(now ?? 0, asked ?? 0)) ?? FULL.at(-1)!);
    this.speed.say(now === null ? "–" : now.toFixed(1), speedUnit(), asked === null ? `of ${this.full}` : `to ${asked.toFixed(1)}`);
    this.speed.draw(bar(now === null ? null : now / this.full, asked === null ? null : asked / this.full));
  }

  private drawThird({ measured, battery_pct, battery_v }: Boat): void {
    const depth = measured?.["depth_m"];
    if (depth) {
      this.third.say(depth.value.toFixed(1), "m", "", "Depth");
      this.third.draw("");
    } else {
      this.third.say(battery_pct !== null ? String(Math.round(battery_pct)) : battery_v === null ? "–" : battery_v.toFixed(1), battery_pct === null ? "V" : "%", "", "Battery");
      this.third.draw(bar(battery_pct === null ? null : battery_pct / 100, null));
    }
  }

  private drawLeft(boat: Boat): void {
    const left_m = sails(boat) ? boat.reference?.distance_m : null;
    const { count, current } = boat.mission;
    const [time, unit] = left_m == null || (boat.speed_mps ?? 0) < STILL_MPS ? ["–", ""] : timeOf(left_m / boat.speed_mps!);
    this.left.say(time, unit, left_m == null ? "" : left_m < 1000 ? `${left_m.toFixed(0)} m` : metres(left_m));
    this.left.draw(bar(boat.mode === "play" && current !== null && count ? (current + 1) / count : null, null));
  }
}

/** A number with a small unit, its name above and what is asked beside that, an instrument below. */
class Figure {
  readonly root: HTMLElement;
  private readonly name = make("span");
  private readonly asked = make("span");
  private readonly value = make("b");
  private readonly unit = make("small");
  private readonly picture = document.createElementNS(SVG, "svg");
  private drawn = "";

  constructor(name: string) {
    text(this.name, name);
    this.picture.setAttribute("viewBox", `0 0 ${WIDE} ${HIGH}`);
    this.picture.setAttribute("preserveAspectRatio", "none");
    this.picture.setAttribute("aria-hidden", "true");
    this.root = make("div.figure", make("p", this.name, this.asked), make("p", this.value, this.unit), this.picture as unknown as Node);
  }

  say(value: string, unit: string, asked: string, name?: string): void {
    if (name) text(this.name, name);
    text(this.value, value);
    text(this.unit, unit);
    text(this.asked, asked);
  }

  draw(picture: string): void {
    if (picture === this.drawn) return;
    this.drawn = picture;
    this.picture.innerHTML = picture;
  }
}

/** The thrust in force from the middle, the one that is asked by hand as a mark, the revolutions measured. */
class Thruster {
  readonly root: HTMLElement;
  private readonly fill = make("i.fill");
  private readonly mark = make("i.mark");
  private readonly words = make("span");
  private readonly rpm = make("span");

  constructor(side: "P" | "S") {
    this.root = make("div.thruster", make("b", side), make("span.bar", make("i.zero"), this.fill, this.mark), this.words, this.rpm);
  }

  draw(pct: number | null, rpm: number | null, asked_pct: number | undefined): void {
    const now = Math.max(-100, Math.min(100, pct ?? 0));
    this.fill.style.left = `${50 + Math.min(now, 0) / 2}%`;
    this.fill.style.width = `${Math.abs(now) / 2}%`;
    hide(this.mark, asked_pct === undefined);
    this.mark.style.left = `${50 + (asked_pct ?? 0) / 2}%`;
    text(this.words, pct === null ? "–" : `${Math.round(pct)} %`);
    text(this.rpm, rpm === null ? "" : `${Math.round(rpm)} rpm`);
    attribute(this.root, "data-known", String(pct !== null));
  }
}

const sails = ({ mode }: Boat): boolean => mode !== null && mode !== "idle" && mode !== "manual";

function timeOf(s: number): [value: string, unit: string] {
  if (s < 100) return [s.toFixed(0), "s"];
  return s < 6000 ? [(s / 60).toFixed(0), "min"] : [(s / 3600).toFixed(s < 36_000 ? 1 : 0), "h"];
}

const at = (part: number): number => Number((Math.max(0, Math.min(1, part)) * WIDE).toFixed(1));

/** What is, and a mark at what is asked; both as a part of the scale. */
function bar(is: number | null, asked: number | null): string {
  const ticks = [0.25, 0.5, 0.75].map((each) => `<path class="tick" d="M${at(each)} 3v8"/>`).join("");
  const fill = is === null ? "" : `<rect class="is" y="5" width="${at(is)}" height="4"/>`;
  return `<rect class="track" y="5" width="${WIDE}" height="4"/>${fill}${ticks}${asked === null ? "" : mark(at(asked))}`;
}

/** The compass about the bow, which is in the middle. */
function tape(heading_deg: number, asked_deg: number | null): string {
  const x = (deg: number) => WIDE / 2 + ((((deg - heading_deg + 540) % 360) - 180) / TAPE_DEG) * (WIDE / 2);
  const tens = Array.from({ length: 2 * (TAPE_DEG / 10) + 1 }, (_, i) => (Math.floor(heading_deg / 10) - TAPE_DEG / 10 + i) * 10);
  const ticks = tens.map((deg) => `<path class="tick" d="M${x((deg + 360) % 360).toFixed(1)} ${deg % 30 ? 7 : 4}V12"/>`).join("");
  const asked = asked_deg === null ? "" : mark(Math.max(3, Math.min(WIDE - 3, x(asked_deg))));
  return `${ticks}<path class="bow" d="M${WIDE / 2} 0V12"/>${asked}`;
}

const mark = (x: number): string => `<path class="mark" d="M${(x - 4).toFixed(1)} 0h8l-4 6zM${x.toFixed(1)} 4v8"/>`;
