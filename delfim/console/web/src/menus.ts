// The menus of a boat and of the bare map: modes, commands, view and screen.
import type { Actions } from "./actions";
import type { Adopt } from "./adopt";
import type { Camera } from "./camera";
import type { Chart, Pixel } from "./chart";
import type { ChartFiles } from "./chartfiles";
import type { Depths } from "./depths";
import type { Fleet } from "./fleet";
import type { Field } from "./form";
import { bearing, position } from "./geo";
import { KEYED } from "./keys";
import * as M from "./mission";
import { THEMES, setTheme, theme } from "./palette";
import { HOLDS_THERE, NONE } from "./planning";
import type { Panes } from "./panes";
import type { Picture } from "./picture";
import type { Planning } from "./planning";
import type { Handle, Plans } from "./plans";
import type { Entry, Item, Popup } from "./popup";
import type { Push } from "./push";
import type { Sound } from "./sound";
import { surveyed } from "./survey";
import { age_s, freshness } from "./state";
import type { State } from "./state";
import type { Timeline } from "./timeline";
import { AHEAD_MIN, ahead_min, inKnots, setAhead, setKnots } from "./units";
import { ZONES_M } from "./watch";
import type { Watch } from "./watch";
import type { WayHome } from "./wayhome";
import type { ValueTrack } from "./valuetrack";
import type { Boat, Mode, Order, Place } from "./wire";

const ELSEWHERE: ReadonlySet<Mode> = new Set(["hold", "course", "trial"]); // modes with an entry of their own, and that of `delfim adopt`
const NOTES: Record<Mode, string> = { goto: HOLDS_THERE, home: "back along the way it came, then hold" };
const PROFILES = ["lean", "radio", "wifi"];

export class Menus {
  constructor(
    private readonly popup: Popup,
    private readonly state: State,
    private readonly actions: Actions,
    private readonly chart: Chart,
    private readonly fleet: Fleet,
    private readonly plans: Plans,
    private readonly planning: Planning,
    private readonly log: () => void,
    private readonly sound: Sound,
    private readonly watch: Watch,
    private readonly wayHome: WayHome,
    private readonly card: () => void,
    private readonly adopt: Adopt,
    private readonly depths: Depths,
    private readonly panes: Panes,
    private readonly timeline: Timeline,
    private readonly camera: Camera,
    private readonly files: ChartFiles,
    private readonly values: ValueTrack,
    private readonly push: Push,
    private readonly picture: Picture,
    private readonly newBoat: () => void,
  ) {}

  boat(boat: Boat, at: Pixel): void {
    if (this.state.replaying) {
      const place = boat.latitude_deg === null ? null : (boat as Place);
      return this.popup.menu(at, { title: boat.name, colour: boat.colour }, [...this.planning.recorded(boat, this.fleet.way(boat.id)), ...this.view(place)]);
    }
    const command = this.commands(boat);
    const enter = (mode: Mode, title: string): Item => ({ title, note: NOTES[mode], tick: boat.mode === mode, do: () => this.planning.sail(boat, mode) });
    const keyed = KEYED.filter(({ mode }) => boat.modes.includes(mode));
    const others = boat.modes.filter((mode) => !ELSEWHERE.has(mode) && !keyed.some((each) => each.mode === mode));
    const entries = (home: boolean) => keyed.filter(({ mode }) => (mode === "home") === home).map(({ key, mode, title }) => ({ ...enter(mode, title), key }));
    const modes = [...entries(false), ...others.map((mode) => enter(mode, capital(mode)))];
    this.popup.menu(at, { title: boat.name, colour: boat.colour }, [
      { title: "Stop", key: "Space", do: () => this.actions.stop(boat.id) },
      command("Pause: hold here", "pause", boat.mode === "idle" && "the boat is idle", "B"),
      command("Continue", "continue", boat.mode !== "hold" && "nothing is paused", "C"),
      ...entries(true),
      "line",
      ...modes,
      "line",
      { title: "Heading…", do: () => this.headingForm(boat, at, "heading") },
      { title: "Course over ground…", do: () => this.headingForm(boat, at, "course") },
      this.actions.byHand(boat)
        ? { title: "Thrust…", key: "0 … 8", do: () => this.thrustForm(boat, at) }
        : { title: "Speed…", key: "0 … 8", do: () => this.speedForm(boat, at) },
      "line",
      { title: "Mission", sub: () => this.planning.mission(boat) },
      { title: "More", sub: () => this.more(boat, at) },
    ]);
    this.wayHome.show(boat.id);
  }

  /** The menu of the bare map. */
  map(place: Place, at: Pixel): void {
    const boat = this.state.replaying ? null : (this.state.boat ?? NONE);
    this.popup.menu(at, { title: position(place), note: this.chart.why(place) ?? "" }, [...(boat ? this.planning.here(boat, place) : []), ...this.view(place)]);
  }

  handle(handle: Handle, at: Pixel): void {
    if (!this.planning.handle(handle, at)) this.map(handle.place, at);
  }

  private headingForm(boat: Boat, at: Pixel, mode: "heading" | "course"): void {
    const now = mode === "course" && boat.mode !== mode ? Math.round(boat.course_deg ?? boat.heading_deg ?? 0) : this.actions.heading_deg(boat);
    const field: Field = { title: capital(mode), unit: "°", value: now, step: 5, least: 0, most: 360, around: true, show: bearing };
    let heading = field.value;
    const live = ([value]: number[]) => {
      heading = value!;
      return "";
    };
    const done = (ok: boolean) => {
      if (!ok) return;
      if (boat.mode === mode) this.actions.headTo(boat, heading);
      else void this.actions.command(boat.id, mode, { [`${mode}_deg`]: heading });
    };
    this.popup.form(at, `${boat.name}: ${mode}`, [field], live, done);
  }

  private speedForm(boat: Boat, at: Pixel): void {
    const field: Field = { title: "Speed", unit: "%", value: this.actions.speed_pct(boat), step: 5, least: 0, most: 100 };
    let speed = field.value;
    const live = ([value]: number[]) => {
      speed = value!;
      return "";
    };
    this.popup.form(at, `${boat.name}: speed`, [field], live, (ok) => ok && this.actions.speed(boat, "both", speed));
  }

  /** Driving by hand without keys. */
  private thrustForm(boat: Boat, at: Pixel): void {
    const field = (title: string, value: number): Field => ({ title, unit: "%", value, step: 5, least: -100, most: 100 });
    let thrust = this.actions.thrust_pct(boat);
    const live = ([port, starboard]: number[]) => {
      thrust = [port!, starboard!];
      return "";
    };
    const done = (ok: boolean) => ok && this.actions.byHand(boat) && this.actions.setThrust(boat, ...thrust);
    this.popup.form(at, `${boat.name}: thrust`, [field("Port", thrust[0]), field("Starboard", thrust[1])], live, done);
  }

  private commands(boat: Boat) {
    return (title: string, name: string, refuse?: string | false, key?: string): Item => ({
      title,
      ...(key && { key }),
      refuse: refuse || undefined,
      do: () => void this.actions.command(boat.id, name),
    });
  }

  /** An order that the boat offers is asked for its keys, or given at once where it has none. */
  private offered(boat: Boat, at: Pixel, { command, name, title: titled, key, keys }: Order): Item {
    const title = titled || capital(name.replaceAll("_", " "));
    const give = (numbers: number[]) => {
      const values = Object.fromEntries(keys.map(([key], i) => [key, numbers[i]!]));
      const words = name ? { name, values } : values;
      void this.actions.command(boat.id, command, words);
    };
    if (!keys.length) return { title, ...(key && { key }), do: () => give([]) };
    const fields = keys.map(([name, least, most, value]): Field => {
      const [, words, unit] = /^(.*)_([a-z]{1,3})$/.exec(name) ?? ["", name, ""];
      return { title: capital(words!.replaceAll("_", " ")), unit: unit === "mps" ? "m/s" : unit!, value, step: 10 ** (Math.ceil(Math.log10(most - least || 1)) - 2), least, most };
    });
    let values = keys.map(([, , , value]) => value);
    const live = (now: number[]) => {
      values = [...now];
      return "";
    };
    return { title: `${title}…`, do: () => this.popup.form(at, `${boat.name}: ${title.toLowerCase()}`, fields, live, (ok) => ok && give(values)) };
  }

  private more(boat: Boat, at: Pixel): Entry[] {
    const command = this.commands(boat);
    return [
      { title: "Hold this position", note: "thrusters start again when it drifts off", do: () => void this.actions.mode(boat, "hold") },
      "line",
      boat.armed ? command("Disarm", "stop") : command("Arm", "arm", !boat.ready && (boat.reason || "not ready")),
      ...(boat.orders ?? []).filter(({ title, name }) => title || name).map((order) => this.offered(boat, at, order)),
      ...this.adopt.items(boat, at),
      this.looks(),
      { title: "Before the start…", do: () => this.panes.open(boat, "checks") },
      { title: "Fetch its logs", sub: () => this.logs(boat) },
      { title: "Send a chart", sub: () => this.files.menu() },
      { title: "Settings…", do: () => this.panes.open(boat, "settings") },
      command("Take control", "take", boat.owner && "this console is in control"),
      { title: "Forget it", note: "off all pages, until it is heard again", refuse: freshness(age_s(this.state, boat)) !== "lost" && "it is heard", do: () => void this.actions.forget(boat.id) },
      "line",
      ...PROFILES.map((name): Item => ({ title: `Link: ${name}`, tick: boat.link.profile === name, do: () => void this.actions.profile(boat.id, name) })),
    ];
  }

  private looks(): Item {
    return { title: "Camera", note: "of the selected boat", tick: this.picture.visible, do: () => this.picture.toggle() };
  }

  private logs({ id }: Boat): Entry[] {
    const item = (title: string, what: "state" | "all" | "end", note: string): Item => ({ title, note, do: () => void this.actions.logs(id, what) });
    return [item("Of its state", "state", "its voyages, with events"), item("All", "all", "every frame of its buses, too"), item("End", "end", "the next time goes on from there")];
  }

  private view(place: Place | null): Entry[] {
    const entries: Entry[] = [
      { title: "Ruler from here", refuse: place ? undefined : "the boat’s position is not known", do: () => this.plans.measure(place) },
      { title: this.everything().length || !this.chart.charted ? "Show everything" : "Show the chart", do: () => this.chart.fit(this.everything(), 250) },
      { title: "Follow the boat", key: "F", tick: this.camera.following, do: () => this.camera.follow() },
      { title: "Course up", key: "N", tick: this.camera.courseUp, do: () => this.camera.turn() },
      { title: "Note…", key: "J", do: () => this.note() },
      this.looks(),
      { title: "Screen", sub: () => this.screen() },
      { title: "Keys and lines", key: "F1", do: this.card },
    ];
    if (this.plans.measured) entries.splice(1, 0, { title: "Remove the rulers", do: () => this.plans.clearRulers() });
    return entries;
  }

  everything(): Place[] {
    const boats = this.state.boats.flatMap((boat) => (boat.latitude_deg === null ? [] : [boat as Place]));
    const aboard = this.state.boats.flatMap((boat) => this.state.aboardOf(boat) ?? []);
    const missions = [...aboard, ...[...this.state.plans.values()].map(({ mission }) => mission)];
    return [...boats, ...this.fleet.allWays, ...missions.flatMap((each) => [...each.waypoints, ...M.path(each), ...surveyed(each), ...each.fence.map(M.cornerPlace)])];
  }

  /** What the operator sees now, for the log of the watch. Space is stop at sea: there a dash stands for one. */
  note(): void {
    const { at_s, replaying, boat } = this.state;
    const said = (words: string) => void this.actions.note(boat?.id ?? 0, replaying ? words : words.replaceAll("-", " "), at_s);
    this.popup.words(`Note${boat ? `: ${boat.name}` : ""}`, replaying ? "With the time that is shown." : "With the time now. Space is stop: a dash becomes one.", said);
  }

  private screen(): Entry[] {
    const charts = this.state.backgrounds.map(
      ({ name }): Item => ({ title: `Chart: ${name}`, tick: this.chart.shown(name), do: () => this.toggle(name) }),
    );
    if (!charts.length) charts.push({ title: "Charts: none", refuse: `drop a cell (.000) on the page, or put charts into ${this.state.chartFolder}` });
    return [
      { title: "Colours", note: theme, sub: () => this.themes() },
      { title: "Knots", tick: inKnots, do: () => setKnots(!inKnots) },
      { title: "Sound", tick: this.sound.on, do: () => this.sound.toggle() },
      this.push.item(this.state.hello?.wakes ?? false),
      { title: "Guard zone", note: this.watch.zone_m ? `${this.watch.zone_m} m around each boat, on this page` : "none on this page", sub: () => this.zones() },
      { title: "Courses", note: `of boats and vessels, ${ahead_min} min ahead`, sub: () => this.aheads() },
      { title: "Depths", note: "as the boats tell them, by colour", tick: this.depths.visible, do: () => this.depths.toggle() },
      { title: "Colour of the tracks", note: this.values.name || "the boat’s", sub: () => this.values.items() },
      { title: "Forget the depths", note: "on all pages: another survey of the same water begins", refuse: this.depths.counts[0] ? undefined : "none were heard", do: () => void this.actions.forgetDepths() },
      ...charts,
      "line",
      { title: "The last ten minutes", note: "speed, depth, link, modes and messages of the boat", tick: this.timeline.visible, do: () => this.timeline.toggle() },
      { title: "Log of the watch", do: this.log },
      { title: "A boat’s file…", note: "of your boat, by questions; or check one", do: this.newBoat },
      { title: "Clear the tracks", do: () => this.fleet.clearTracks() },
      { title: "Full screen", do: () => void document.documentElement.requestFullscreen() },
    ];
  }

  themes(): Entry[] {
    return THEMES.map(
      (each): Item => ({
        title: capital(each),
        tick: theme === each,
        do: () => {
          setTheme(each);
          this.state.tell("theme");
        },
      }),
    );
  }

  /** A vessel nearer than this is marked and heard on this page; the boat's own limits are in its file. */
  private zones(): Entry[] {
    return ZONES_M.map((m): Item => ({ title: m ? `${m} m` : "None", tick: this.watch.zone_m === m, do: () => this.watch.setZone(m) }));
  }

  private aheads(): Entry[] {
    const item = (each: number): Item => ({
      title: `${each} min`,
      tick: ahead_min === each,
      do: () => {
        setAhead(each);
        this.state.tell("theme");
      },
    });
    return AHEAD_MIN.map(item);
  }

  private toggle(chart: string): void {
    this.chart.toggle(chart);
    this.state.tell("theme");
  }
}

const capital = (word: string): string => word.charAt(0).toUpperCase() + word.slice(1);
