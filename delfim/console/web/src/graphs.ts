// A time line, live or of a recorded run: its marks, and graphs of speed, depth, charge and other values with those of the time that is shown.
import { make, text } from "./dom";
import { valueWords } from "./measured";
import { severityWord } from "./messages";
import type { Event, Graphs, TimeLine, WatchLine } from "./wire";

const SHOWN_MOST = 3;
const FIRST = ["speed_mps", "depth_m", "battery_pct"];
const [WIDE, HIGH] = [1000, 30];
const GAP = 0.02; // of the time line: a longer silence is a gap
const OLD_S = 10;
const SVG = "http://www.w3.org/2000/svg";

const GRAVITY: Record<string, number> = { emergency: 0, alarm: 1, warning: 4, caution: 4 };

export class TimeStrip {
  readonly root = make("div.values");
  readonly marks = make("div.marks");
  private shown: { name: string; points: [number, number][]; words: HTMLElement }[] = [];
  private readonly now = make("i.now");

  constructor(private readonly seek: (part: number) => void) {
    this.root.addEventListener("click", ({ clientX }) => {
      const { left, width } = this.root.getBoundingClientRect();
      seek((clientX - left) / width);
    });
  }

  mark(events: Event[], { from_s, to_s }: TimeLine): void {
    const seen = events.filter(({ at_s }) => at_s >= from_s && at_s <= to_s);
    this.marks.replaceChildren(
      ...seen.map(({ at_s, severity, text: words, note }) => {
        const mark = make("i");
        const part = (at_s - from_s) / Math.max(to_s - from_s, 1);
        mark.style.left = `${100 * part}%`;
        mark.dataset["severity"] = note ? "note" : severityWord(severity);
        mark.title = `${utc(at_s)} ${words}`;
        mark.addEventListener("click", () => this.seek(part));
        return mark;
      }),
    );
  }

  /** The graphs of one boat; `chosen` comes first. */
  draw(graphs: Graphs, range: TimeLine, chosen = ""): void {
    const rank = (name: string) => (name === chosen ? -1 : FIRST.includes(name) ? FIRST.indexOf(name) : FIRST.length);
    const names = Object.keys(graphs).sort((a, b) => rank(a) - rank(b) || a.localeCompare(b));
    this.shown = names.slice(0, SHOWN_MOST).map((name) => ({ name, points: graphs[name]!, words: make("figcaption") }));
    this.root.replaceChildren(...this.shown.map(({ points, words }) => make("figure", plotted(points, range) as unknown as Node, words)), this.now);
    this.root.hidden = !this.shown.length;
  }

  tell(at_s: number, { from_s, to_s }: TimeLine): void {
    this.now.style.left = `${(100 * (at_s - from_s)) / Math.max(to_s - from_s, 1)}%`;
    for (const { name, points, words } of this.shown) {
      const value = points.findLast(([t]) => t <= at_s && t > at_s - Math.max(OLD_S, GAP * (to_s - from_s)))?.[1];
      const all = points.map(([, each]) => each);
      const figures = (each: number) => String(Number(each.toFixed(1)));
      const label = value === undefined ? `${valueWords(name, 0).replace(/ ?-?[\d.].*$/, "")} –` : valueWords(name, value);
      text(words, `${label}  (${figures(Math.min(...all))} to ${figures(Math.max(...all))})`);
    }
  }
}

function plotted(points: [number, number][], { from_s, to_s }: TimeLine): SVGElement {
  const all = points.map(([, value]) => value);
  const [least, most, span] = [Math.min(0, ...all), Math.max(...all), Math.max(to_s - from_s, 1)];
  const x = (at_s: number) => ((at_s - from_s) / span) * WIDE;
  const y = (value: number) => HIGH - 2 - ((value - least) / (most - least || 1)) * (HIGH - 4);
  const far = Math.max(GAP * span, OLD_S);
  const way = points.map(([at_s, value], i) => `${i && at_s - points[i - 1]![0] < far ? "L" : "M"}${x(at_s).toFixed(1)} ${y(value).toFixed(1)}`).join("");
  const picture = document.createElementNS(SVG, "svg");
  picture.setAttribute("viewBox", `0 0 ${WIDE} ${HIGH}`);
  picture.setAttribute("preserveAspectRatio", "none");
  const line = document.createElementNS(SVG, "path");
  line.setAttribute("d", way);
  picture.append(line);
  return picture;
}

/** A line of the log of the watch as a mark. */
export const marked = ({ at_s, boat, who, what, text }: WatchLine): Event => ({ at_s, boat, severity: GRAVITY[what] ?? 6, text: who === "boat" ? text : `${who}: ${text}`, note: what === "note" });

export const utc = (at_s: number): string => new Date(1000 * at_s).toISOString().slice(11, 19);
