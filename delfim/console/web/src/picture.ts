// The picture of the selected boat's camera. Its age is always told, and a frozen one is never taken for a live one.
import { make, text } from "./dom";
import type { Net } from "./net";
import type { State } from "./state";
import type { Shot } from "./wire";

const KEPT_MS = 4000;
const LOOK_MS = 1000;
const DRAW_MS = 100;
const OLD_S = 3;
const SAME_S = 5; // a real camera's pictures differ by their noise

export class Picture {
  private boat: number | null = null;
  private camera = "";
  private shot: Shot | null = null; // with a picture
  private came = [0, 0];
  private readonly image = make("img");
  private readonly name = make("button.plain");
  private readonly age = make("output");
  private readonly said = make("b");
  private kept: [string, number] = ["", 0]; // what became of Keep, and until when it is shown
  private readonly box = make("section", make("header", this.name, this.age), this.image, this.said);

  constructor(
    parent: HTMLElement,
    private readonly net: Net,
    private readonly state: State,
  ) {
    this.box.id = "picture";
    this.box.hidden = true;
    this.box.setAttribute("aria-label", "the boat’s camera");
    this.said.setAttribute("role", "status");
    const button = (title: string, act: () => void) => {
      const made = make("button.plain", title);
      made.addEventListener("click", act);
      return made;
    };
    this.box.firstChild!.appendChild(button("Keep", () => void this.keep()));
    this.box.firstChild!.appendChild(button("Close", () => this.toggle()));
    for (const each of this.box.querySelectorAll("button")) each.tabIndex = -1;
    this.name.addEventListener("click", () => this.next());
    setInterval(() => this.look(), LOOK_MS);
    setInterval(() => this.draw(), DRAW_MS);
    parent.append(this.box);
  }

  get visible(): boolean {
    return !this.box.hidden;
  }

  toggle(): void {
    this.box.hidden = !this.box.hidden;
    this.boat = null;
    this.look();
    this.draw(); // its name, too: no button is without a word
  }

  take(shot: Shot): void {
    if (shot.boat !== this.boat || (this.camera && shot.camera !== this.camera)) return;
    if (!shot.jpeg) {
      text(this.said, shot.why);
      this.shot ??= shot;
      return;
    }
    [this.shot, this.came] = [shot, [performance.now(), Date.now()]];
    this.image.src = `data:image/jpeg;base64,${shot.jpeg}`;
    this.draw();
  }

  private look(): void {
    const boat = this.state.selected;
    if (!this.visible) return;
    if (boat !== this.boat) this.forget(boat);
    if (boat === null) return;
    void this.net.ask({ t: "see", boat, camera: this.camera }).then(({ ok, reason }) => !ok && boat === this.boat && text(this.said, reason));
  }

  private forget(boat: number | null): void {
    [this.boat, this.camera, this.shot] = [boat, "", null];
    this.image.removeAttribute("src");
    text(this.said, "");
  }

  /** The next camera of the boat. */
  private next(): void {
    const { cameras = [], camera = "" } = this.shot ?? {};
    const boat = this.boat;
    this.forget(boat);
    this.camera = cameras[(cameras.indexOf(camera) + 1) % cameras.length] ?? "";
    this.look();
  }

  private async keep(): Promise<void> {
    if (this.boat === null) return;
    const { ok, reason } = await this.net.ask({ t: "snapshot", boat: this.boat });
    this.kept = [ok ? `kept as ${reason}` : reason, performance.now() + KEPT_MS];
    text(this.age, this.kept[0]);
  }

  /** Two clocks count: one of them stands still while the computer sleeps. */
  private draw(): void {
    if (!this.visible) return;
    const boat = this.state.byId(this.boat ?? -1);
    const { shot } = this;
    text(this.name, `${boat?.name ?? ""} ${shot?.camera ?? this.camera}`);
    this.image.alt = `camera ${shot?.camera ?? ""}`;
    if (!shot?.jpeg) return text(this.age, "no picture");
    const since_s = Math.max(performance.now() - this.came[0]!, Date.now() - this.came[1]!) / 1000;
    const age_s = this.state.replaying ? this.state.at_s - shot.taken_s! : shot.age_s! + since_s;
    const same_s = shot.same_s! + since_s;
    const old = age_s > OLD_S || !this.state.online;
    this.box.classList.toggle("old", old);
    text(this.age, performance.now() < this.kept[1] ? this.kept[0] : `${age_s.toFixed(1)}\u00a0s${shot.kbps ? `, ${shot.kbps}\u00a0kbit/s` : ""}`);
    text(this.said, old ? `picture is ${Math.round(age_s)} s old${shot.why ? `: ${shot.why}` : ""}` : same_s > SAME_S && !this.state.replaying ? `picture has not changed for ${Math.round(same_s)} s` : "");
  }
}
