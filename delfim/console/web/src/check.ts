// The plan as the boat would judge it, asked of the gateway after each change: the boat's own code and file, with no boat needed.
import type { Actions } from "./actions";
import { counted, isSurvey } from "./area";
import type { Chart } from "./chart";
import { attribute, hide, make, text } from "./dom";
import { metres } from "./geo";
import { length_m } from "./mission";
import type { Answer } from "./net";
import type { State } from "./state";
import type { Mission } from "./wire";

const NEAR_M = 30; // of the map: from the place where missions come too near to the no-go water

export class Check {
  private asked: Mission | null = null; // the answer to this is shown, or is under way
  private answer: Answer | null = null;
  private busy = false;
  private readonly what = make("b");
  private readonly words = make("span");

  constructor(
    private readonly box: HTMLElement,
    private readonly state: State,
    private readonly actions: Actions,
    private readonly chart: Chart,
  ) {
    box.append(this.what, this.words);
    state.on(["hello"], () => (this.asked = null)); // the gateway may be another one
    state.on(["hello", "plan", "selection", "boats"], () => this.look());
  }

  /** Nothing to say of a plan that is empty, or aboard: that boat has taken it. */
  private get mission(): Mission | null {
    const { boat, planning, replaying } = this.state;
    const { mission } = this.state.plan(planning);
    return !mission.waypoints.length || replaying || (boat && this.state.compared(boat) === "same") ? null : mission;
  }

  private look(): void {
    if (!this.busy && this.mission !== this.asked) {
      this.asked = this.mission;
      if (this.asked) void this.ask(this.asked);
    }
    this.draw();
  }

  private async ask(mission: Mission): Promise<void> {
    this.busy = true;
    this.answer = await this.actions.check(this.state.planning, mission);
    this.busy = false;
    this.look();
  }

  private draw(): void {
    const { answer, mission } = this;
    hide(this.box, !mission || !answer);
    if (!mission || !answer) return;
    const size = `${counted(mission)} · ${metres(length_m(mission))}`;
    const words = answer.ok ? `in order${answer.reason ? `; ${answer.reason}` : ""}` : answer.reason.replace(/^mission refused: /, "");
    const place = this.state.crossed.get(this.state.planning);
    const why = place && !answer.ok && this.chart.why({ latitude_deg: place[0], longitude_deg: place[1] }, NEAR_M);
    attribute(this.box, "data-state", answer.ok ? "well" : "wrong");
    text(this.what, `${isSurvey(mission) ? "survey" : "plan"}: ${size}`);
    text(this.words, why ? `${words} (${why})` : words);
    document.documentElement.style.setProperty("--check", `${this.box.offsetHeight}px`); // below it stands what is told of vessels
  }
}
