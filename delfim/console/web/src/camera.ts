// What the map keeps to: the selected boat in sight, and its course up. A hand on the map ends the first; the arrow beside the scale says where north is.
import type { Chart } from "./chart";
import { attribute, make } from "./dom";
import { position } from "./fleet";
import type { State } from "./state";

const STEADY_MPS = 0.3; // the course of a boat that is slower says nothing: its heading is up
const STEP_DEG = 4; // the map turns by no less, so that it stands still on a leg

export class Camera {
  readonly button = make("button.plain", "Follow");
  following = false;
  courseUp = false;

  constructor(
    private readonly chart: Chart,
    private readonly state: State,
    private readonly north: HTMLElement,
  ) {
    this.button.tabIndex = -1;
    this.button.title = "keeps the selected boat in sight (F)";
    this.button.addEventListener("click", () => this.follow());
    north.addEventListener("click", () => this.turn());
    chart.onMoved(() => {
      if (this.following) this.follow();
    });
    state.on(["boats", "selection"], () => this.keep());
    this.point(0);
  }

  /** Keeps the selected boat in sight, or no longer. */
  follow(): void {
    this.following = !this.following;
    this.button.classList.toggle("pressed", this.following);
    attribute(this.button, "aria-pressed", String(this.following));
    this.keep();
  }

  /** The course of the selected boat up, or north. */
  turn(): void {
    this.courseUp = !this.courseUp;
    if (this.courseUp) this.keep();
    else this.point(0);
  }

  private keep(): void {
    const { boat } = this.state;
    const place = boat && position(boat);
    if (!place) return;
    const up_deg = (boat.speed_mps ?? 0) > STEADY_MPS ? (boat.course_deg ?? boat.heading_deg) : (boat.heading_deg ?? boat.course_deg);
    if (this.courseUp && up_deg !== null && Math.abs(((up_deg - this.chart.up_deg + 540) % 360) - 180) > STEP_DEG) this.point(up_deg);
    if (this.following) this.chart.follow(place, 0);
  }

  private point(up_deg: number): void {
    this.chart.up_deg = up_deg;
    this.north.style.setProperty("--turn", `${-up_deg}deg`);
    attribute(this.north, "aria-label", this.courseUp ? "course up: press for north" : "north is up: press for the boat’s course");
  }
}
