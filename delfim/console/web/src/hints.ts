// What a person who is here for the first time must be told: where things are, until it was found, and that there is no boat yet.
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
      if (!nobody.hidden) nobody.replaceChildren(make("b", state.nobody), make("span", "A mission can be planned meanwhile. It becomes the plan of the first boat."));
    };
    state.on(["hello", "boats"], draw);
  }

  /** It was found: it goes away, and does not come again. */
  used(): void {
    this.hint.hidden = true;
    localStorage.setItem(KEPT, "1");
  }
}
