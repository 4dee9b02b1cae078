// The picture of the selected boat's camera. Its age is always told, and a frozen one is never taken for a live one.
import { make, text } from "./dom";
import { Live } from "./live";
import type { Net } from "./net";
import type { State } from "./state";
import type { Answer, Shot } from "./wire";

const KEPT_MS = 4000;
const LOOK_MS = 1000;
const DRAW_MS = 100;
const OLD_S = 3;
const AGAIN_MS = 30_000; // after WebRTC failed, and each time twice as long
const AGAIN_MOST_MS = 480_000;
const SAME_S = 5; // a real camera's pictures differ by their noise

/** What is known of a picture: its age when it came, since when it was the same, when it was taken, and when it came. */
interface Told {
  age_s: number;
  same_s: number;
  taken_s: number;
  came: [number, number];
}

/** Two clocks count: one of them stands still while the computer sleeps. */
const clocks = (): [number, number] => [performance.now(), Date.now()];

export class Picture {
  private boat: number | null = null;
  private camera = "";
  private shot: Shot | null = null; // with a picture
  private came = clocks();
  private live: Live | null = null; // while WebRTC is tried, or shows the picture
  private pause_ms = AGAIN_MS;
  private liveFrom_ms = 0;
  private film: Told | null = null; // of the picture on the page, if it is that of WebRTC
  private readonly video = make("video");
  private readonly image = make("img");
  private readonly name = make("button.plain");
  private readonly age = make("output");
  private readonly said = make("b");
  private timer = 0;
  private kept: [string, number] = ["", 0]; // what became of Keep, and until when it is shown
  private readonly box = make("section", make("header", this.name, this.age), this.image, this.video, this.said);

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
    this.video.hidden = this.video.muted = this.video.autoplay = this.video.playsInline = true;
    this.name.addEventListener("click", () => this.next());
    setInterval(() => this.look(), LOOK_MS);
    parent.append(this.box);
  }

  get visible(): boolean {
    return !this.box.hidden;
  }

  toggle(): void {
    this.box.hidden = !this.box.hidden;
    this.boat = null;
    clearInterval(this.timer);
    if (this.visible) this.timer = window.setInterval(() => this.draw(), DRAW_MS);
    this.look();
    this.draw(); // its name, too: no button is without a word
  }

  take(shot: Shot): void {
    if (shot.boat !== this.boat || (this.camera && shot.camera !== this.camera)) return;
    if (!shot.live) {
      if (this.live) this.failed();
    } else if (!this.live && performance.now() > this.liveFrom_ms && !document.hidden && Live.possible) void this.begin();
    if (!shot.jpeg) {
      text(this.said, shot.why);
      this.shot ??= shot;
      return;
    }
    [this.shot, this.came] = [shot, clocks()];
    this.image.src = `data:image/jpeg;base64,${shot.jpeg}`;
    this.draw();
  }

  answered(answer: Answer): void {
    if (answer.boat !== this.boat || answer.of !== this.live?.offer?.user) return;
    if (answer.why) this.failed();
    else this.live.take(answer);
  }

  private async begin(): Promise<void> {
    try {
      const live = (this.live = new Live(this.video, (age_s, same_s, taken_s) => {
        if (live !== this.live) return;
        this.film = { age_s, same_s, taken_s, came: clocks() };
        [this.video.hidden, this.image.hidden] = [false, true];
      }));
      await live.begin();
    } catch {
      return this.failed();
    }
    this.look();
  }

  /** WebRTC shows nothing (any more): stills go on, and it is tried again later. */
  private failed(): void {
    [this.liveFrom_ms, this.pause_ms] = [performance.now() + this.pause_ms, Math.min(2 * this.pause_ms, AGAIN_MOST_MS)];
    this.still();
    this.look();
  }

  /** From now on stills, the last of which is at hand. */
  private still(): void {
    this.live?.close();
    this.live = null;
    [this.film, this.video.hidden, this.image.hidden] = [null, true, false];
  }

  private look(): void {
    const boat = this.state.selected;
    if (!this.visible) return;
    if (boat !== this.boat) this.forget(boat);
    if (boat === null) return;
    const offer = this.live?.offer;
    const live = offer ? { live: { ...offer, shown: this.film !== null } } : {};
    void this.net.ask({ t: "see", boat, camera: this.camera, ...live }).then(({ ok, reason }) => !ok && boat === this.boat && text(this.said, reason));
  }

  private forget(boat: number | null): void {
    this.still();
    [this.boat, this.camera, this.shot, this.liveFrom_ms, this.pause_ms] = [boat, "", null, 0, AGAIN_MS];
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
    const film = this.film ? { jpeg: this.live!.still(), taken_s: this.film.taken_s } : {};
    const { ok, reason } = await this.net.ask({ t: "snapshot", boat: this.boat, ...film });
    this.kept = [ok ? `kept as ${reason}` : reason, performance.now() + KEPT_MS];
    text(this.age, this.kept[0]);
  }

  private draw(): void {
    if (this.live && (!this.visible || document.hidden)) this.still();
    if (this.live?.broken) this.failed();
    if (this.film && this.live!.lasted) this.pause_ms = AGAIN_MS;
    if (!this.visible) return;
    const boat = this.state.byId(this.boat ?? -1);
    const { shot } = this;
    text(this.name, `${boat?.name ?? ""} ${shot?.camera ?? this.camera}`);
    this.video.ariaLabel = this.image.alt = `camera ${shot?.camera ?? ""}`;
    const told = this.film ?? (shot?.jpeg ? { age_s: shot.age_s!, same_s: shot.same_s!, taken_s: shot.taken_s!, came: this.came } : null);
    if (!told || !shot) return text(this.age, "no picture");
    const [now_ms, day_ms] = clocks();
    const since_s = Math.max(now_ms - told.came[0], day_ms - told.came[1]) / 1000;
    const age_s = this.state.replaying ? this.state.at_s - told.taken_s : told.age_s + since_s;
    const same_s = told.same_s + since_s;
    const old = age_s > OLD_S || !this.state.online;
    this.box.classList.toggle("old", old);
    text(this.age, performance.now() < this.kept[1] ? this.kept[0] : `${age_s.toFixed(1)}\u00a0s${shot.kbps ? `, ${shot.kbps}\u00a0kbit/s` : ""}`);
    text(this.said, old ? `picture is ${Math.round(age_s)} s old${shot.why ? `: ${shot.why}` : ""}` : same_s > SAME_S && !this.state.replaying ? `picture has not changed for ${Math.round(same_s)} s` : "");
  }
}
