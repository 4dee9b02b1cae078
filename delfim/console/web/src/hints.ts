// The first voyage in five hints, each until it was done once, and the word that no boat is heard yet.
import { linesOf } from "./area";
import { hide, make, text } from "./dom";
import type { Popup } from "./popup";
import { NOBODY } from "./state";
import type { State } from "./state";
import type { Boat } from "./wire";

const KEPT = "delfim.hinted"; // how many were done
const SAILS = ["play", "path", "goto"];
const TOUCH = matchMedia("(pointer: coarse)").matches;

interface Hint {
  words(boat: Boat | null): string;
  /** Whether it was done; asked again whenever something changes. */
  done(boat: Boat | null): boolean;
}

export class Hints {
  private step = Number(localStorage.getItem(KEPT) ?? 0);
  private menuOpened = false;
  private readonly words = make("span");
  private readonly steps: readonly Hint[] = [
    {
      words: () => (TOUCH ? "Tap the map, a boat or a waypoint: a menu opens" : "Click the map, a boat or a waypoint: a menu opens · F1: keys and lines"),
      done: () => this.menuOpened,
    },
    {
      words: () => "Draw a mission: “Add waypoint” in the menu of a place, two of them or more. Drag one to move it",
      done: () => this.did.has("draw"),
    },
    {
      words: (boat) => (boat ? "Menu, “Mission”, “Send to the boat”: what is dashed is only on this screen" : "Menu, “Mission”, “Save”: a file on this computer. The first boat that is heard gets the plan, too"),
      done: (boat) => this.did.has(boat ? "upload" : "save"),
    },
    { words: (boat) => (boat ? this.order(boat) : ""), done: () => SAILS.some((each) => this.did.has(each)) },
    { words: (boat) => (boat ? `The red corner${TOUCH ? "" : ", or Space,"} stops the boat at once` : ""), done: () => this.did.has("stop") },
  ];

  constructor(
    private readonly hint: HTMLElement,
    nobody: HTMLElement,
    private readonly state: State,
    private readonly did: ReadonlySet<string>, // by the hand of whoever is at this page; what boats do by themselves is no lesson
    popup: Popup,
  ) {
    const close = make("button", "×");
    close.setAttribute("aria-label", "No more hints");
    close.tabIndex = -1;
    close.addEventListener("click", () => this.end());
    hint.append(this.words, close);
    popup.opened = () => this.used();
    state.on(["hello", "boats", "plan", "missions"], () => {
      this.draw();
      hide(nobody, !state.hello || state.replaying || state.boats.length > 0);
      nobody.classList.toggle("aside", this.planned > 0 || state.backgrounds.length > 0);
      if (!nobody.hidden) nobody.replaceChildren(make("b", state.nobody), make("span", "You can plan a mission now: it becomes the plan of the first boat."));
    });
    this.draw();
  }

  /** A menu was found. */
  used(): void {
    this.menuOpened = true;
    this.draw();
  }

  private order(boat: Boat): string {
    const [title, key] = linesOf(this.state.plan(boat.id).mission).length ? ["Path following", "P"] : ["Play mission", "Y"];
    return `“${title}” in the boat’s menu${TOUCH ? "" : `, or ${key},`} sails what is aboard`;
  }

  private end(): void {
    this.keep(this.steps.length);
    this.draw();
  }

  private keep(step: number): void {
    this.step = step;
    localStorage.setItem(KEPT, String(step));
  }

  private draw(): void {
    const { boat, replaying } = this.state;
    while (this.steps[this.step]?.done(boat)) this.keep(this.step + 1);
    const words = replaying && this.step ? "" : (this.steps[this.step]?.words(boat) ?? "");
    text(this.words, words);
    hide(this.hint, !words);
  }

  private get planned(): number {
    return this.state.plans.get(NOBODY)?.mission.waypoints.length ?? 0;
  }
}
