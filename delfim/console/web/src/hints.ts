// Hints for a first-time user: where the menus are, until one was opened, and that no boat is heard yet.
import { make } from "./dom";
import type { Popup } from "./popup";
import type { State } from "./state";

const KEPT = "delfim.hinted";

export class Hints {
  constructor(
    private readonly hint: HTMLElement,
    nobody: HTMLElement,
    state: State,
    popup: Popup,
  ) {
    const touch = matchMedia("(pointer: coarse)").matches;
    hint.append(touch ? "Tap the map, a boat or a waypoint: a menu opens" : "Click the map, a boat or a waypoint: a menu opens · ", ...(touch ? [] : [make("kbd", "F1"), " keys and lines"]));
    hint.hidden = localStorage.getItem(KEPT) !== null;
    popup.opened = () => this.used();
    const draw = () => {
      nobody.hidden = !state.hello || state.replaying || state.boats.length > 0;
      if (!nobody.hidden) nobody.replaceChildren(make("b", state.nobody), make("span", "You can plan a mission now: it becomes the plan of the first boat."));
    };
    state.on(["hello", "boats"], draw);
  }

  /** The menu was found: the hint goes away for good. */
  used(): void {
    this.hint.hidden = true;
    localStorage.setItem(KEPT, "1");
  }
}
