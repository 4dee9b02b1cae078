// The keys of the thesis (section 4.3), and stop. Letters are taken by character, digits and arrows by their place on the keyboard.
import type { Actions } from "./actions";
import type { Thrusters } from "./drive";
import type { State } from "./state";
import type { Boat, Mode } from "./wire";

const ARROW_EVERY_MS = 100;

/** The modes that have a key; the menu has every mode that the boat reports. */
export const KEYED: readonly { key: string; mode: Mode; title: string; says: string }[] = [
  { key: "I", mode: "idle", title: "Idle", says: "thrusters are powered off" },
  { key: "M", mode: "manual", title: "Manual", says: "thrusters are set here" },
  { key: "H", mode: "heading", title: "Heading", says: "follow a heading" },
  { key: "L", mode: "home", title: "Go home", says: "leave: back along the way it came, then hold" },
  { key: "U", mode: "unstick", title: "Unstick", says: "astern, out by the way it came, then hold" },
  { key: "G", mode: "goto", title: "Go to waypoint 1", says: "then hold: thrusters start again; or idle, if its file says so" },
  { key: "P", mode: "path", title: "Path following", says: "follow the path that connects the waypoints" },
  { key: "Y", mode: "play", title: "Play mission", says: "each waypoint in turn, then hold" },
  { key: "X", mode: "grex", title: "GREX", says: "follow the guest computer" },
];

type Group = readonly [title: string, rows: readonly (readonly [string, string])[]];

const SCREEN: Group = [
  "Screen",
  [
    ["+ −", "zoom"],
    ["F", "follow the boat, or no longer; a hand on the map ends it"],
    ["N", "the boat’s course up, or north"],
    ["W", "crosshair: arrows move the map, Enter opens the menu of the place"],
    ["K", "acknowledge the alert in the bar, and vessels in danger"],
    ["S", "silence: no sound of alarms for half a minute"],
    ["A", "the list of alerts, with what was"],
    ["J", "a note for the log of the watch and the time line"],
    ["Esc", "close"],
    ["F6", "the next button on the screen; Enter presses it"],
    ["F1", "this card"],
  ],
];

export const REPLAY_CARD: readonly Group[] = [
  [
    "Replay",
    [
      ["Space", "play, pause"],
      ["→ ←", "10 s on, 10 s back"],
      ["↑ ↓", "faster, slower"],
    ],
  ],
  [
    "Boats",
    [
      ["Tab", "next boat; Shift Tab: previous"],
      ["Enter", "the boat's menu"],
    ],
  ],
  SCREEN,
];

export const CARD: readonly Group[] = [
  [
    "Stop",
    [
      ["Space", "stop this boat"],
      ["Shift Space", "stop all boats"],
    ],
  ],
  [
    "Mode",
    [
      ...KEYED.map(({ key, title, says }) => [key, `${title}: ${says}`] as const),
      ["B", "Pause: hold here; thrusters start again when it drifts off"],
      ["C", "Continue where it was paused"],
    ],
  ],
  [
    "Speed",
    [
      ["0 … 8", "0 % … 80 %"],
      ["9", "no function, so that a slip beside 0 is not 90 %"],
      ["↑ ↓", "common speed ± 1 %"],
      ["→ ←", "turn to starboard, to port"],
      ["Alt", "with these: the starboard thruster only"],
      ["Ctrl", "with these: the port thruster only"],
    ],
  ],
  [
    "Boats",
    [
      ["Tab", "next boat; Shift Tab: previous"],
      ["O", "overrule the guard: give way to nobody for 10 minutes; O again: give way again"],
      ["R", "reset the boat's peripheral microcontrollers"],
      ["Enter", "the boat's menu"],
    ],
  ],
  [
    "Plan",
    [
      ["W W", "crosshair; W again puts a waypoint there"],
      ["Ctrl Z", "undo the last change of the plan"],
    ],
  ],
  SCREEN,
];

export interface Screen {
  /** A menu that is open takes the arrows, Enter and Esc; true when it took the key. */
  menuTakes(key: string): boolean;
  closeMenu(): void;
  openMenu(): void;
  toggleCard(): void;
  /** Asks the operator first when the mission aboard differs from the plan on the screen. */
  enterMode(boat: Boat, mode: Mode): void;
  nobody(): void;
  aim(): void;
  follow(): void;
  keep(): void;
  turn(): void;
  zoom(by: number): void;
  undo(): void;
  /** Somebody has taken note of the alert in the bar, and of the vessels in danger. */
  acknowledge(): void;
  silence(): void;
  alerts(): void;
  note(): void;
  replayTakes(key: string): boolean;
}

const ARROWS = new Set(["ArrowUp", "ArrowDown", "ArrowLeft", "ArrowRight"]);

export class Keys {
  private lastArrow = -Infinity;
  private reached: HTMLElement | null = null; // by F6

  constructor(
    private readonly state: State,
    private readonly actions: Actions,
    private readonly screen: Screen,
  ) {
    window.addEventListener("keydown", (event) => this.down(event), { capture: true });
    // A lone Alt opens the browser's menu when it is let go.
    window.addEventListener("keyup", (event) => event.key === "Alt" && event.preventDefault(), { capture: true });
  }

  private down(event: KeyboardEvent): void {
    if (event.isComposing || event.metaKey) return;
    if (isTyped(event, this.state.replaying)) return;
    if (event.key === "F12" || (event.ctrlKey && event.shiftKey && !ARROWS.has(event.code))) return; // the browser's own tools
    if (this.taken(event)) {
      event.preventDefault();
      event.stopPropagation();
    }
  }

  private taken(event: KeyboardEvent): boolean {
    const { replaying } = this.state;
    if (event.code === "Space" && !replaying) return this.stop(event);
    if (!event.ctrlKey && !event.altKey && this.screen.menuTakes(event.shiftKey && event.key === "Tab" ? "Shift Tab" : event.key)) return true;
    if (replaying) return this.screen.replayTakes(event.code) || this.view(event);
    return this.digit(event) || this.view(event) || this.arrow(event) || this.letter(event);
  }

  private stop(event: KeyboardEvent): boolean {
    this.screen.closeMenu();
    if (event.repeat) return true;
    if (event.shiftKey) this.actions.stopAll();
    else if (this.state.boat) this.actions.stop(this.state.boat.id);
    if (!this.state.boat) this.screen.nobody();
    return true;
  }

  private view(event: KeyboardEvent): boolean {
    if (event.key === "Tab" && !event.ctrlKey && !event.altKey) this.next(event.shiftKey ? -1 : 1);
    else if (event.key.toUpperCase() === "W" && !event.ctrlKey && !event.altKey) this.screen.aim();
    else if (event.key.toUpperCase() === "K" && !event.ctrlKey && !event.altKey) this.screen.acknowledge();
    else if (event.key.toUpperCase() === "F" && !event.ctrlKey && !event.altKey) this.screen.keep();
    else if (event.key.toUpperCase() === "N" && !event.ctrlKey && !event.altKey) this.screen.turn();
    else if (event.key.toUpperCase() === "S" && !event.ctrlKey && !event.altKey) this.screen.silence();
    else if (event.key.toUpperCase() === "A" && !event.ctrlKey && !event.altKey) this.screen.alerts();
    else if (event.key.toUpperCase() === "J" && !event.ctrlKey && !event.altKey) this.screen.note();
    else if (event.key === "F6") this.reach(event.shiftKey ? -1 : 1);
    else if (event.key === "Enter" && this.reached?.getClientRects().length && document.activeElement === this.reached) this.reached.click();
    else if (event.key === "F1") this.screen.toggleCard();
    else if (event.key === "Escape") this.screen.closeMenu();
    else if (event.key === "Enter") this.screen.openMenu();
    else if (event.key === "+" || event.key === "=") this.screen.zoom(1);
    else if (event.key === "-") this.screen.zoom(-1);
    else if (event.ctrlKey && !event.altKey && event.key.toLowerCase() === "z") this.screen.undo();
    else return false;
    return true;
  }

  /** The buttons that no other key presses: those of hints, vessels, a replay. STOP is Space, a menu has its arrows. */
  private reach(by: number): void {
    const buttons = [...document.querySelectorAll<HTMLElement>("button")].filter((each) => each.getClientRects().length && !each.closest("#corner, .popup"));
    const at = this.reached ? buttons.indexOf(this.reached) : by < 0 ? 0 : -1;
    this.reached = buttons[(at + by + buttons.length) % buttons.length] ?? null;
    this.reached?.focus();
  }

  private next(by: number): void {
    const { boats, selected } = this.state;
    if (!boats.length) return;
    const at = boats.findIndex((each) => each.id === selected);
    this.screen.closeMenu();
    this.state.select(boats[(at + by + boats.length) % boats.length]!.id);
    this.screen.follow();
  }

  private digit(event: KeyboardEvent): boolean {
    const digit = event.code.match(/^(?:Digit|Numpad)([0-9])$/)?.[1];
    if (digit === undefined || (event.code.startsWith("Numpad") && event.key !== digit)) return false;
    if (digit !== "9" && !event.repeat && this.state.boat) this.actions.speed(this.state.boat, which(event), 10 * Number(digit));
    return true;
  }

  private arrow(event: KeyboardEvent): boolean {
    if (!ARROWS.has(event.code)) return false;
    const boat = this.state.boat;
    if (!boat || (event.repeat && event.timeStamp - this.lastArrow < ARROW_EVERY_MS)) return true;
    this.lastArrow = event.timeStamp;
    if (event.code === "ArrowUp") this.actions.faster(boat, which(event), 1);
    else if (event.code === "ArrowDown") this.actions.faster(boat, which(event), -1);
    else if (event.code === "ArrowRight") this.actions.turn(boat, which(event), 1);
    else this.actions.turn(boat, which(event), -1);
    return true;
  }

  private letter(event: KeyboardEvent): boolean {
    if (event.ctrlKey || event.altKey || event.key.length !== 1) return event.altKey && event.key.length === 1;
    const [boat, key] = [this.state.boat, event.key.toUpperCase()];
    const mode = KEYED.find((each) => each.key === key)?.mode;
    const order = boat?.orders?.find((each) => each.key === key);
    if (!mode && !order) return false;
    if (event.repeat) return true;
    this.screen.closeMenu();
    if (!boat) this.screen.nobody();
    else if (mode) this.screen.enterMode(boat, mode);
    else if (order) void this.actions.command(boat.id, order.command);
    return true;
  }
}

/** Whether the key writes into a field. Space is stop wherever it is pressed, but in a replay; in a number the arrows move on, and letters are modes. */
function isTyped(event: KeyboardEvent, replaying: boolean): boolean {
  const { target, key } = event;
  if (!(target instanceof HTMLInputElement) || target.type !== "text" || (event.code === "Space" && !replaying) || ["Enter", "Escape", "Tab", "F1", "F6"].includes(key)) return false;
  if (key === "ArrowUp" || key === "ArrowDown") return false;
  if (event.ctrlKey) return !event.altKey && "acvxz".includes(key.toLowerCase());
  return target.inputMode !== "decimal" || (!event.altKey && /^([\d.,+-]|Backspace|Delete|Home|End)$/.test(key));
}

function which(event: KeyboardEvent): Thrusters {
  if (event.altKey === event.ctrlKey) return "both";
  return event.altKey ? "starboard" : "port";
}
