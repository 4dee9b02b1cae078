// The time line of a recorded run. The gateway plays; this sets time and rate.
import type { Actions } from "./actions";
import { make, text } from "./dom";
import { duration } from "./geo";
import { TimeStrip, marked, utc } from "./graphs";
import type { State } from "./state";
import type { Graphs, WatchLine } from "./wire";

const RATES = [1, 2, 5, 10, 30, 60];
const STEP_S = 10;

export class Replay {
  private readonly slider = make("input");
  private readonly clock = make("output");
  private readonly play = make("button.plain");
  private readonly faster = make("button.plain");
  private rate = 1;
  private paused = false;
  private held = false;
  private readonly graphs = new Map<number, Graphs>();
  private readonly strip = new TimeStrip((part) => {
    const { from_s, to_s } = this.state.hello!.replay!;
    this.seek(from_s + part * (to_s - from_s));
  });

  constructor(
    private readonly bar: HTMLElement,
    private readonly state: State,
    private readonly actions: Actions,
    follow: HTMLElement,
  ) {
    this.slider.type = "range";
    this.slider.step = "0.1";
    for (const each of [this.slider, this.play, this.faster]) each.tabIndex = -1;
    this.slider.setAttribute("aria-label", "time");
    bar.append(make("b", "REPLAY"), this.play, make("div.line", this.slider, this.strip.marks, this.strip.root), this.clock, this.faster, follow);
    this.play.addEventListener("click", () => this.toggle());
    this.faster.addEventListener("click", () => this.setRate(RATES[(RATES.indexOf(this.rate) + 1) % RATES.length]!));
    this.slider.addEventListener("pointerdown", () => (this.held = true));
    this.slider.addEventListener("input", () => this.tell(Number(this.slider.value)));
    this.slider.addEventListener("change", () => {
      this.held = false;
      this.actions.replay({ at_s: Number(this.slider.value) });
    });
    state.on(["hello"], () => this.begin());
    state.on(["boats"], () => !this.held && this.tell(this.state.at_s));
    state.on(["selection"], () => this.plot());
  }

  /** In a replay there is nothing to stop or to steer: Space plays and pauses, the arrows go through time. */
  takes(code: string): boolean {
    if (code === "Space") this.toggle();
    else if (code === "ArrowLeft" || code === "ArrowRight") this.seek(this.state.at_s + (code === "ArrowRight" ? STEP_S : -STEP_S));
    else if (code === "ArrowUp" || code === "ArrowDown") {
      const next = RATES.indexOf(this.rate) + (code === "ArrowUp" ? 1 : -1);
      this.setRate(RATES[Math.max(0, Math.min(RATES.length - 1, next))]!);
    } else return false;
    return true;
  }

  take(boat: number, graphs: Graphs): void {
    this.graphs.set(boat, graphs);
    this.plot();
  }

  /** Of the selected boat. */
  private plot(): void {
    const range = this.state.hello?.replay;
    if (!range) return;
    this.strip.draw(this.graphs.get(this.state.selected ?? 0) ?? {}, range);
    this.strip.tell(this.state.at_s, range);
  }

  private begin(): void {
    const range = this.state.hello?.replay;
    this.bar.hidden = !range;
    document.documentElement.classList.toggle("replaying", Boolean(range));
    if (!range) return;
    this.slider.min = String(range.from_s);
    this.slider.max = String(range.to_s);
    this.strip.mark(range.events ?? [], range);
    this.show();
  }

  /** Notes that are made while it is shown. */
  note(lines: WatchLine[]): void {
    const range = this.state.hello?.replay;
    if (!range) return;
    range.events = [...(range.events ?? []), ...lines.filter(({ what }) => what === "note").map(marked)];
    this.strip.mark(range.events, range);
  }

  private toggle(): void {
    this.paused = !this.paused;
    this.actions.replay({ rate: this.paused ? 0 : this.rate });
    this.show();
  }

  private setRate(rate: number): void {
    this.rate = rate;
    this.paused = false;
    this.actions.replay({ rate });
    this.show();
  }

  private seek(at_s: number): void {
    const { from_s, to_s } = this.state.hello!.replay!;
    this.actions.replay({ at_s: Math.max(from_s, Math.min(to_s, at_s)) });
  }

  private show(): void {
    text(this.play, this.paused ? "▶" : "❚❚");
    this.play.setAttribute("aria-label", this.paused ? "play" : "pause");
    text(this.faster, `× ${this.rate}`);
    this.faster.setAttribute("aria-label", `rate × ${this.rate}`);
  }

  private tell(at_s: number): void {
    const range = this.state.hello?.replay;
    if (!range || !at_s) return;
    if (!this.held) this.slider.value = String(at_s);
    this.strip.tell(at_s, range);
    text(this.clock, `${utc(at_s)} · ${duration(at_s - range.from_s)} of ${duration(range.to_s - range.from_s)}`);
  }
}
