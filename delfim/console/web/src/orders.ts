// The commands of a watch as a row at the selected boat: pause, continue, home, play. The others are in the menus and on keys.
import type { Actions } from "./actions";
import { attribute, make } from "./dom";
import type { Screen } from "./keys";
import type { Boat } from "./wire";

export class OrderRow {
  readonly root = make("div.row.orders");
  private boat: Boat;
  private readonly pause: HTMLButtonElement;
  private readonly resume: HTMLButtonElement;

  constructor(boat: Boat, actions: Actions, screen: Pick<Screen, "enterMode">) {
    this.boat = boat;
    this.pause = button("Pause", "B", () => void actions.command(this.boat.id, "pause"));
    this.resume = button("Continue", "C", () => void actions.command(this.boat.id, "continue"));
    const home = button("Home", "L", () => screen.enterMode(this.boat, "home"));
    const play = button("Play", "Y", () => screen.enterMode(this.boat, "play"));
    this.root.append(this.pause, this.resume, home, play);
  }

  draw(boat: Boat): void {
    this.boat = boat;
    attribute(this.root, "data-log", String(boat.link.kind === "log")); // a recorded boat obeys nobody
    attribute(this.pause, "aria-disabled", String(boat.mode === "idle"));
    attribute(this.resume, "aria-disabled", String(boat.mode !== "hold"));
  }
}

function button(title: string, key: string, act: () => void): HTMLButtonElement {
  const made = make("button.plain", title);
  made.tabIndex = -1;
  made.title = `${title} (${key})`;
  made.addEventListener("click", (event) => {
    event.stopPropagation();
    if (made.getAttribute("aria-disabled") !== "true") act();
  });
  return made;
}
