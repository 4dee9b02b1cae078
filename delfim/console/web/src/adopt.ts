// The trial of a boat (docs/adopt.md): its circle on the map, its steps, its questions, and what was found.
import Feature from "ol/Feature";
import type { Polygon } from "ol/geom";
import { circular } from "ol/geom/Polygon";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Stroke, Style } from "ol/style";
import type { Chart, Pixel } from "./chart";
import { make } from "./dom";
import { duration, metres, towards } from "./geo";
import type { Messages } from "./messages";
import type { Net } from "./net";
import { palette } from "./palette";
import type { Item, Popup } from "./popup";
import type { State } from "./state";
import type { Boat, Heard, Place, Said } from "./wire";

type Trial = Extract<Heard, { t: "adoption" }>;
type Deed = Extract<Said, { t: "adopt" }>["do"];

const RADIUS_M = 60;
const AGAIN = /^(Adopted already|The hull is not adopted)/; // what a trial that is begun afresh may change

export class Adopt {
  private trial: Trial | null = null;
  private readonly circle = new VectorSource({ useSpatialIndex: false });

  constructor(
    private readonly box: HTMLElement,
    private readonly chart: Chart,
    private readonly state: State,
    private readonly popup: Popup,
    private readonly net: Net,
    private readonly messages: Messages,
  ) {
    chart.add(new VectorLayer({ source: this.circle }), 2);
    state.on(["theme"], () => this.draw());
  }

  /** The entries of a boat's menu. */
  items(boat: Boat, at: Pixel): Item[] {
    const other = this.state.hello?.adopts !== boat.id && "start delfim console with --vehicle FILE, the file of this boat";
    const refuse = other || (this.trial?.is_running && "a trial is under way");
    return [
      { title: "Motors at the berth…", note: "with lines on, each turns for a second", refuse, do: () => this.do(boat.id, "berth") },
      { title: "Adopt…", note: "a trial of her motors and hull, on the water", refuse, do: () => this.form(boat, at) },
    ];
  }

  private form(boat: Boat, at: Pixel): void {
    let radius_m = RADIUS_M;
    if (boat.latitude_deg !== null) this.chart.fit([0, 90, 180, 270].map((deg) => towards(boat as Place, deg, 1.4 * RADIUS_M)));
    const live = ([value]: number[]) => {
      radius_m = value!;
      if (boat.latitude_deg !== null) this.ring(boat.latitude_deg, boat.longitude_deg!, radius_m);
      return "A circle about where she is now, which she does not leave. It is to be free, upstream and upwind, away from piers.";
    };
    const done = (ok: boolean) => {
      this.draw();
      if (ok) this.do(boat.id, "begin", radius_m);
    };
    this.popup.form(at, `Adopt ${boat.name}`, [{ title: "Circle, radius", unit: "m", value: RADIUS_M, step: 5, least: 15, most: 160 }], live, done);
  }

  private do(boat: number, deed: Deed, radius_m?: number): void {
    void this.net.ask({ t: "adopt", boat, do: deed, ...(radius_m === undefined ? {} : { radius_m }) }).then((answer) => {
      if (!answer.ok) this.messages.say(boat, 3, `adopt refused: ${answer.reason}`);
    });
  }

  take(trial: Trial): void {
    this.trial = trial.boat === null ? null : trial;
    this.draw();
  }

  private draw(): void {
    const { trial } = this;
    this.circle.clear();
    this.box.hidden = !trial;
    if (!trial) return this.box.replaceChildren();
    const { circle, boat } = trial;
    if (circle && trial.is_running) this.ring(circle.latitude_deg, circle.longitude_deg, circle.radius_m);
    const bar = make("progress");
    [bar.max, bar.value] = [1, trial.part];
    const lines = make("div.lines", ...trial.lines.map((each) => make(/\S {2,}\S|^ {2}/.test(each) ? "pre" : "p", each))); // rows of a table keep their columns
    this.box.replaceChildren(
      make("header", make("b", `Adopt ${this.state.byId(boat!)?.name ?? ""}`), make("span", this.now(trial))),
      bar,
      make("ol", ...trial.steps.filter(({ name, state }) => state !== "done" || (trial.is_running && name !== "back")).map(row)),
      ...(trial.lines.length ? [lines] : []),
      ...(trial.end && trial.end !== "done" ? [make("p.bad", `The end: ${trial.end}`)] : []),
      ...(trial.is_written && !trial.is_running ? [make("p", `Written into ${trial.file} on the console’s computer. A boat with a computer of her own needs it there: download it, put it aboard, and start her program again.`)] : []),
      this.choice(trial),
    );
    lines.scrollTop = lines.scrollHeight;
    this.box.scrollTop = this.box.scrollHeight; // what is asked, or the end
  }

  private now({ is_running, question, steps }: Trial): string {
    if (!is_running) return "over";
    if (question) return "waits for you";
    return steps.at(-1) ? duration(steps.at(-1)!.elapsed_s) : "";
  }

  private choice(trial: Trial): HTMLElement {
    const button = (title: string, deed: Deed, kind = "plain") => {
      const made = make(`button.${kind}` as "button", title);
      made.addEventListener("click", () => this.do(trial.boat!, deed));
      return made;
    };
    const link = (title: string, href: string) => Object.assign(make("a", title), { href, target: "_blank" });
    const files = trial.is_running ? [] : [trial.report && link("Report", "adoption.html"), trial.is_written && link("Download her file", "adopted.toml")];
    const again = trial.lines.some((each) => AGAIN.test(each)) ? [button("Begin afresh", "afresh")] : [];
    const buttons = !trial.is_running ? [...again, button("Close", "close")] : trial.question ? [button("No", "no"), button("Yes", "yes", "main")] : [button("End the trial", "end")];
    return make("footer", trial.question && make("p.question", trial.question), ...files, make("div.choice", ...buttons));
  }

  private ring(latitude_deg: number, longitude_deg: number, radius_m: number): void {
    const ring = new Feature(circular([longitude_deg, latitude_deg], radius_m, 72).transform("EPSG:4326", "EPSG:3857") as Polygon);
    ring.setStyle(new Style({ stroke: new Stroke({ color: palette.steer, width: 2, lineDash: [10, 6] }) }));
    this.circle.clear();
    this.circle.addFeature(ring);
  }
}

function row({ words, name, state, reason, far_m }: Trial["steps"][number]): HTMLElement {
  const made = make("li", make("span", words || name), state === "under way" ? make("i", metres(far_m)) : null, reason ? make("small", reason) : null);
  made.dataset["state"] = state;
  return made;
}
