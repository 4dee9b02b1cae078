// The last ten minutes of the selected boat: speed, what it measures, and the loss of its link, with marks: each change of mode, and what the log of the watch says of it.
import { TimeStrip, marked } from "./graphs";
import type { State } from "./state";
import { age_s, freshness } from "./state";
import type { ValueTrack } from "./valuetrack";
import type { Boat, Event, Graphs, WatchLine } from "./wire";

const SPAN_S = 600;
const EVERY_S = 1;
const MARKS_MOST = 200;
const KEPT = "delfim.timeline";

interface Kept {
  graphs: Graphs;
  marks: Event[];
  mode: string | null;
  last_s: number;
}

export class Timeline {
  private readonly kept = new Map<number, Kept>();
  private readonly strip = new TimeStrip(() => {});
  private drawn_s = 0;
  visible = localStorage.getItem(KEPT) === "on";

  constructor(
    private readonly box: HTMLElement,
    private readonly state: State,
    private readonly values: ValueTrack,
  ) {
    box.append(this.strip.root, this.strip.marks);
    state.on(["boats"], () => this.extend());
    state.on(["selection"], () => this.draw());
    state.on(["forgotten"], () => {
      for (const id of this.kept.keys()) if (!state.byId(id)) this.kept.delete(id);
    });
  }

  toggle(): void {
    this.visible = !this.visible;
    localStorage.setItem(KEPT, this.visible ? "on" : "off");
    this.draw();
  }

  /** Lines of the log of the watch. */
  take(lines: WatchLine[]): void {
    for (const line of lines) for (const id of line.boat === null && line.what === "note" ? this.kept.keys() : [line.boat]) if (id !== null) this.mark(id, marked(line));
    this.draw();
  }

  private mark(boat: number, event: Event): void {
    const { marks } = this.of(boat);
    marks.push(event);
    if (marks.length > MARKS_MOST) marks.shift();
  }

  private of(boat: number): Kept {
    let its = this.kept.get(boat);
    if (!its) this.kept.set(boat, (its = { graphs: {}, marks: [], mode: null, last_s: -Infinity }));
    return its;
  }

  private extend(): void {
    for (const boat of this.state.boats) this.add(boat, this.of(boat.id));
    if (this.visible && Math.abs(this.state.at_s - this.drawn_s) >= EVERY_S) this.draw();
  }

  private add(boat: Boat, its: Kept): void {
    const { at_s } = this.state;
    if (boat.mode !== its.mode && its.mode !== null && boat.mode !== null) this.mark(boat.id, { at_s, boat: boat.id, severity: 6, text: boat.mode });
    its.mode = boat.mode ?? its.mode;
    if (at_s < its.last_s + EVERY_S || freshness(age_s(this.state, boat)) === "lost") return;
    its.last_s = at_s;
    const young = Object.entries(boat.measured ?? {}).map(([name, { value, age_s }]) => [name, age_s < 2 * EVERY_S ? value : null] as const);
    const values = { speed_mps: boat.speed_mps, "link lost_pct": boat.link.loss_pct, ...Object.fromEntries(young) };
    for (const [name, value] of Object.entries(values) as [string, number | null][]) if (value !== null) (its.graphs[name] ??= []).push([at_s, value]);
    for (const points of Object.values(its.graphs)) while (points.length && points[0]![0] < at_s - SPAN_S) points.shift();
    while (its.marks.length && its.marks[0]!.at_s < at_s - SPAN_S) its.marks.shift();
  }

  private draw(): void {
    const { at_s, selected } = this.state;
    this.drawn_s = at_s;
    const its = selected === null ? undefined : this.kept.get(selected);
    this.box.hidden = !this.visible || !its || this.state.replaying;
    document.documentElement.classList.toggle("timed", !this.box.hidden);
    if (this.box.hidden || !its) return;
    const range = { from_s: at_s - SPAN_S, to_s: at_s };
    this.strip.draw(Object.fromEntries(Object.entries(its.graphs).filter(([, points]) => points.length)), range, this.values.name);
    this.strip.tell(at_s, range);
    this.strip.mark(its.marks, range);
  }
}
