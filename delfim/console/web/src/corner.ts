// Boxes over the map: the stop corner, the key card, the result of a dry run, the position of the pointer.
import type { Actions } from "./actions";
import { attribute, make, text } from "./dom";
import { position as boatPosition } from "./fleet";
import { bearing, bearing_deg, distance_m, duration, metres, position } from "./geo";
import { CARD, REPLAY_CARD } from "./keys";
import type { State } from "./state";
import type { Place } from "./wire";

/** Always visible, with the same code as the keys: no menu, no question; it acts as soon as the finger comes down. */
export class Corner {
  private readonly name: Element;

  constructor(
    private readonly stop: HTMLElement,
    private readonly all: HTMLElement,
    private readonly state: State,
    private readonly actions: Actions,
    close: () => void,
    nobody: () => void,
  ) {
    this.name = stop.lastElementChild!;
    const press = (button: HTMLElement, act: () => void) =>
      button.addEventListener("pointerdown", (event) => {
        event.preventDefault();
        close();
        act();
      });
    press(stop, () => (state.selected === null ? nobody() : actions.stop(state.selected)));
    press(all, () => (state.boats.length ? actions.stopAll() : nobody()));
    state.on(["boats", "selection"], () => this.draw());
  }

  draw(): void {
    const { boat } = this.state;
    text(this.name, boat?.name ?? "");
    const stopping = boat !== null && this.actions.stopping.has(boat.id);
    attribute(this.stop, "data-state", stopping ? "stopping" : boat?.mode === "idle" ? "idle" : "ready");
    const others = this.state.boats.filter((each) => each.id !== this.state.selected);
    attribute(this.all, "data-state", others.some((each) => this.actions.stopping.has(each.id)) ? "stopping" : "ready");
  }
}

/** The legend: a class of the style sheet, and its meaning. */
const LINES: readonly (readonly [string, string])[] = [
  ["aboard", "the mission aboard the boat"],
  ["draft", "a plan not yet sent to the boat"],
  ["band", "its path, for path following"],
  ["survey", "an area to survey, and its lines while they are planned"],
  ["done", "a line of a survey that was sailed"],
  ["station", "a station: purple while it waits for its sample, green once it is taken, red without one"],
  ["steering", "where the boat is steering"],
  ["home", "its way home, while its menu is open or it goes there"],
  ["course", "its course, a tick each minute"],
  ["track", "its past track"],
  ["vessel", "another vessel and its course"],
  ["vessel danger", "one that comes near, and its domain"],
  ["zone", "fence and obstacles aboard the boat"],
  ["zone draft", "fence and obstacles not yet sent"],
];

export function card(parent: HTMLElement, state: State): { toggle(): void; close(): boolean } {
  const group = ([title, rows]: (typeof CARD)[number]) =>
    make(
      "section",
      make("h2", title),
      ...rows.map(([keys, words]) => make("div.key", make("span", ...keys.split(" ").flatMap((key) => [key === "…" ? "…" : make("kbd", key), " "])), make("p", words))),
    );
  const legend = () =>
    make("section", make("h2", "Lines on the map"), ...LINES.map(([look, words]) => make("div.key", make(`i.line.${look.replace(" ", ".")}`), make("p", words))));
  const box = make("div.card");
  box.id = "card";
  box.setAttribute("role", "dialog");
  box.setAttribute("aria-label", "Keys and lines");
  box.tabIndex = 0; // arrows scroll it
  box.hidden = true;
  box.addEventListener("click", () => (box.hidden = true));
  parent.append(box);
  return {
    toggle: () => {
      box.replaceChildren(make("div", ...(state.replaying ? REPLAY_CARD : CARD).map(group), legend()));
      box.hidden = !box.hidden;
    },
    close: () => {
      const was = !box.hidden;
      box.hidden = true;
      return was;
    },
  };
}

export function dryRunCard(box: HTMLElement, state: State): void {
  const draw = () => {
    const run = state.selected === null ? undefined : state.dryruns.get(state.selected);
    box.hidden = !run;
    if (run) box.replaceChildren(make("span", "dry run"), make("b", duration(run.time_s)), make("b", metres(run.distance_m)));
  };
  box.addEventListener("click", () => {
    if (state.selected !== null) state.dryruns.delete(state.selected);
    state.tell("dryrun");
  });
  state.on(["dryrun", "selection"], draw);
}

export function whereWords(place: Place, state: State): string {
  const boat = state.boat;
  const from = boat && boatPosition(boat);
  const range = from ? `     ${metres(distance_m(from, place))}  ${bearing(bearing_deg(from, place))} from ${boat.name}` : "";
  return position(place) + range;
}
