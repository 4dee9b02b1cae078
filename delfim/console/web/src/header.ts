// The right of the bar: which console this is and whose, how many boats are heard, sound, colours.
import { attribute, make, text } from "./dom";
import type { Menus } from "./menus";
import { theme } from "./palette";
import type { Popup } from "./popup";
import type { Sound } from "./sound";
import type { State } from "./state";
import { age_s, freshness } from "./state";

export class Header {
  private readonly me = make("output.me");
  private readonly links = make("output.links");
  private readonly sounds = make("button.plain.sound");
  private readonly colours = make("button.plain.colours");

  constructor(
    bar: HTMLElement,
    private readonly state: State,
    private readonly sound: Sound,
    menus: Menus,
    popup: Popup,
  ) {
    for (const each of [this.sounds, this.colours]) each.tabIndex = -1;
    this.sounds.addEventListener("click", () => {
      sound.toggle();
      this.draw();
    });
    this.colours.addEventListener("click", () => {
      const { left, bottom } = this.colours.getBoundingClientRect();
      popup.menu([left, bottom], { title: "Colours" }, menus.themes());
    });
    this.links.title = "boats that are heard, of those that are known";
    bar.append(this.links, this.me, this.sounds, this.colours);
    state.on(["hello", "boats", "theme"], () => this.draw());
    this.draw();
  }

  private draw(): void {
    const { hello, boats, operator } = this.state;
    const heard = boats.filter((each) => freshness(age_s(this.state, each)) !== "lost").length;
    text(this.links, `Links ${heard}/${boats.length}`);
    text(this.me, hello?.replay ? "Replay" : hello ? `Console ${hello.me}${operator ? ` · ${operator}` : ""}` : "");
    text(this.sounds, this.sound.on ? "Sound on" : "Sound off");
    attribute(this.sounds, "aria-pressed", String(this.sound.on));
    text(this.colours, theme.charAt(0).toUpperCase() + theme.slice(1));
    attribute(this.colours, "aria-label", `${this.colours.textContent}: other colours`);
  }
}
