// The console's page: puts the parts together and passes the gateway's messages to them.
import "ol/ol.css";
import "./tokens.css";
import "./style.css";
import { Actions } from "./actions";
import { Adopt } from "./adopt";
import { Aim } from "./aim";
import { Alerts } from "./alerts";
import { Bridge } from "./bridge";
import { Calm } from "./calm";
import { Camera } from "./camera";
import type { Pixel } from "./chart";
import { Chart } from "./chart";
import { ChartFiles } from "./chartfiles";
import { Check } from "./check";
import { Depths } from "./depths";
import { Corner, card, dryRunCard, whereWords } from "./corner";
import { text } from "./dom";
import { Drive } from "./drive";
import { tellFailures } from "./failed";
import { Fleet, position } from "./fleet";
import { Pad } from "./gamepad";
import { Header } from "./header";
import { Hints } from "./hints";
import { keepOffline, makeWay } from "./installed";
import { Keys } from "./keys";
import { Land } from "./land";
import { Menus } from "./menus";
import { Messages } from "./messages";
import { understood } from "./mission";
import { Net } from "./net";
import { NewBoat } from "./newboat";
import { Planning } from "./planning";
import { PlanFiles } from "./planfiles";
import { Plans } from "./plans";
import { type Theme, setTheme } from "./palette";
import { Popup } from "./popup";
import { Push } from "./push";
import { Replay } from "./replay";
import { Sound } from "./sound";
import { Others, vesselLines } from "./others";
import { Panes } from "./panes";
import { NOBODY, State, ageWords } from "./state";
import { Survey, surveyed } from "./survey";
import { Picture } from "./picture";
import { Strips } from "./strip";
import { Timeline } from "./timeline";
import { Traffic } from "./traffic";
import { ValueTrack } from "./valuetrack";
import { Watch } from "./watch";
import { WatchLog } from "./watchlog";
import { WayHome } from "./wayhome";
import type { Background, Boat, Heard, Mission, Place, Vessel } from "./wire";

const REACH_PX = 22;
const REACH_TOUCH_PX = 32;
const APART: ReadonlySet<Heard["t"]> = new Set(["boats", "depths", "picture", "answer"]); // what comes often and leans on nothing that a boat told just before

const element = (id: string): HTMLElement => document.getElementById(id)!;

tellFailures(element("failed"));
keepOffline();
const state = new State();
const sound = new Sound();
const messages = new Messages(element("said"), state, sound);
const net = new Net(heard, online);
const alerts = new Alerts(element("bar"), state, net, sound);
const watchLog = new WatchLog(document.body);
const panes = new Panes(document.body, net);
const picture = new Picture(document.body, net, state);
const newBoat = new NewBoat(document.body);
const drive = new Drive(net, state, () => strips.draw(false));
const actions = new Actions(net, state, drive, (boat, severity, words) => messages.say(boat, severity, words), () => corner.draw());
const popup = new Popup(document.body, element("corner"));
const bridge = new Bridge(element("bar"), net, popup, (severity, words) => messages.say(null, severity, words), (name) => (state.operator = name));
const keyCard = card(document.body, state);
const chart = new Chart(element("map"), element("scale"), { click, press, hover });
const camera = new Camera(chart, state, element("north"));
const land = new Land(chart, state, element("base"));
const fleet = new Fleet(chart, state);
const calm = new Calm(chart, drive, ({ boats, at_s, came }) => took(boats, at_s, came));
const watch = new Watch(state, sound);
const others = new Others(chart, state, watch);
const plans = new Plans(chart, state, (mission) => edit(state.planning, mission));
const survey = new Survey(chart, popup, state, plans, net, messages, edit);
const chartFiles = new ChartFiles(chart, popup, state, messages, actions);
const files = new PlanFiles(chart, state, survey, messages, chartFiles, edit);
const planning = new Planning(popup, state, actions, chart, plans, messages, edit, undo, survey, files);
const wayHome = new WayHome(chart, state, net);
popup.closed = () => wayHome.show(null);
const depths = new Depths(element("depths"), chart, state, survey);
const adopt = new Adopt(element("adopt"), chart, state, popup, net, messages);
const values = new ValueTrack(element("values"), chart, state);
const timeline = new Timeline(element("timeline"), state, values);
const menus = new Menus(popup, state, actions, chart, fleet, plans, planning, () => watchLog.open(), sound, watch, wayHome, () => keyCard.toggle(), adopt, depths, panes, timeline, camera, chartFiles, values, new Push((severity, words) => messages.say(null, severity, words)), picture, () => newBoat.open());
new Header(element("bar"), state, sound, menus, popup);
const hints = new Hints(element("hint"), element("nobody"), state, actions.did, popup);
const aim = new Aim(element("map"), chart, { seen: (place) => text(element("where"), whereWords(place, state)), chosen: press, added: (place) => !state.replaying && planning.add(place) });
const strips = new Strips(element("strips"), state, drive, actions, (boat, at) => chosen(boat, at), { enterMode: (boat, mode) => planning.sail(boat, mode) });
const corner = new Corner(element("stop"), element("stop-all"), state, actions, () => popup.close(), nobody);
const replay = new Replay(element("replay"), state, actions, camera.button);
new Keys(state, actions, {
  menuTakes: (key) => popup.takes(key) || panes.takes(key) || newBoat.takes(key) || (key === "Escape" && (keyCard.close() || panes.close() || newBoat.close() || watchLog.close() || alerts.close())) || aim.takes(key),
  closeMenu: escape,
  openMenu,
  toggleCard: () => {
    hints.used();
    keyCard.toggle();
  },
  enterMode: (boat, mode) => planning.sail(boat, mode),
  nobody,
  aim: () => {
    moved = true;
    aim.press();
  },
  keep: () => camera.follow(),
  turn: () => camera.turn(),
  follow: () => state.boat && position(state.boat) && chart.follow(position(state.boat)!),
  zoom: (by) => {
    moved = true;
    chart.zoom(by);
  },
  undo,
  acknowledge: () => {
    watch.acknowledge();
    alerts.acknowledge();
  },
  silence: () => alerts.silence(),
  alerts: () => alerts.toggle(),
  note: () => menus.note(),
  replayTakes: (code) => replay.takes(code),
});
dryRunCard(element("dryrun"), state);
new Traffic(element("traffic"), state, watch, (vessel, at) => tell(vessel, at));
new Check(element("check"), state, actions, chart);
new Pad(state, actions, drive, (boat, severity, words) => messages.say(boat, severity, words));

let [placed, fitted, moved] = [false, false, false]; // a boat was brought into view; a mission too; the operator has chosen the view

chart.paint();
state.on(["theme"], () => chart.paint());
state.on(["boats", "plan"], show);
state.on(["boats"], () => tellTime(element("utc")));
for (const event of ["pointerdown", "wheel"]) element("map").addEventListener(event, () => (moved = true), { capture: true, passive: true });
state.on(["selection"], () => document.querySelector(".chip.selected")?.scrollIntoView({ block: "nearest", inline: "nearest" }));
setInterval(listen, 500);
for (const name of ["strips", "replay"]) new ResizeObserver(pad).observe(element(name));
window.addEventListener("beforeunload", (event) => {
  if (state.boats.some((boat) => drive.hand(boat.id) || (boat.armed && boat.owner))) event.preventDefault();
});

function heard(message: Heard): void {
  if (!APART.has(message.t)) calm.tell();
  switch (message.t) {
    case "hello":
      if (!state.hello) makeWay(message.built ?? "");
      state.hello = message;
      document.title = `Delfim · console ${message.me}`;
      takeCharts(message.backgrounds);
      fleet.forgetWays();
      depths.forget();
      if (!message.boats.length && !moved) chart.findCharts();
      took(message.boats, state.at_s);
      state.tell("hello");
      void net.ask({ t: "mission", boat: state.planning, do: "list" });
      return;
    case "charts":
      takeCharts(message.backgrounds);
      return state.tell("theme");
    case "boats":
      return calm.take(message.boats, message.at_s);
    case "vessels":
      return state.takeVessels(message.vessels, message.heard_s);
    case "whole_track":
      fleet.whole(message.boat, message.points);
      if (!moved) chart.fit(menus.everything());
      return;
    case "way_home":
      return wayHome.take(message);
    case "graphs":
      replay.take(message.boat, message.graphs);
      pad();
      if (!moved) chart.fit(menus.everything());
      return;
    case "track":
      return fleet.history(message.boat, message.start ?? false, message.points);
    case "forgotten":
      return state.forget(message.boat);
    case "text":
      return message.alarm ? undefined : messages.say(message.boat, message.severity, message.text);
    case "alerts":
      return alerts.take(message.alerts);
    case "bridge":
      return bridge.take(message);
    case "ended":
      return alerts.takeEnded(message.alerts, message.all);
    case "log":
      if (!state.replaying) timeline.take(message.lines);
      else if (!message.all) replay.note(message.lines);
      return watchLog.take(message.lines, message.all);
    case "mission":
      return tookMission(message.boat, message.where, understood(message.mission));
    case "missions":
      state.names = message.names;
      return state.tell("missions");
    case "depths":
      return depths.take(message);
    case "aboard":
      return panes.take(message);
    case "no_depths":
      return depths.forget();
    case "picture":
      return picture.take(message);
    case "live":
      return picture.answered(message);
    case "adoption":
      return adopt.take(message);
    case "survey":
      return survey.take(message);
    case "progress":
      if (message.part >= 1) state.progress.delete(message.boat);
      else state.progress.set(message.boat, message);
      return state.tell("progress");
    case "crossed":
      if (message.place) state.crossed.set(message.boat, message.place);
      else state.crossed.delete(message.boat);
      return state.tell("dryrun");
    case "dryrun":
      state.dryruns.set(message.boat, message);
      return state.tell("dryrun");
    case "answer":
      return;
  }
}

function online(now: boolean): void {
  state.online = now;
  element("offline").hidden = now;
  if (!now) drive.release("the console was offline");
}

function takeCharts(backgrounds: Background[]): void {
  state.backgrounds = backgrounds;
  chart.setBackgrounds(backgrounds);
}

/** The first boat gets the plan that was made before it was heard. */
function took(boats: Boat[], at_s: number, came?: number): void {
  const first = state.selected === null;
  state.takeBoats(boats, at_s, came);
  if (first && state.selected !== null && state.inherit(state.selected)) planned(state.selected);
}

/** A replay sends the mission aboard as the plan: nobody plans in a replay. */
function tookMission(boat: number, where: "here" | "aboard", mission: Mission): void {
  if (where === "aboard" || state.replaying) state.takeAboard(boat, mission);
  else state.takeMission(boat, mission);
  if (where === "aboard" && state.fetching.delete(boat)) edit(boat, mission);
}

/** There is nothing to stop or to steer. */
function nobody(): void {
  messages.say(null, 4, `${state.nobody}: nothing to command`);
}

function edit(boat: number, mission: Mission): void {
  if (mission.waypoints.length > 1) actions.did.add("draw");
  state.plan(boat).change(mission);
  planned(boat);
}

function undo(): void {
  state.plan(state.planning).undo();
  planned(state.planning);
}

/** The gateway keeps the plan: the page may be closed. */
function planned(boat: number): void {
  state.dryruns.delete(boat);
  state.crossed.delete(boat);
  state.tell("dryrun");
  state.tell("plan");
  if (boat !== NOBODY) void actions.mission(boat, "put");
}

function chosen(boat: Boat, at: Pixel): void {
  state.select(boat.id);
  menus.boat(boat, at);
}

/** What is known of another vessel. */
function tell(vessel: Vessel, at: Pixel): void {
  const name = (boat: number) => state.byId(boat)?.name ?? `boat ${boat}`;
  const note = vessel.name === vessel.key ? "" : vessel.key;
  popup.menu(at, { title: vessel.name, note }, vesselLines(vessel, name).map((title) => ({ title, do: () => {} })));
}

function openMenu(): void {
  if (survey.isDrawing) return survey.close();
  const boat = state.boat;
  if (!boat) return;
  const place = position(boat);
  menus.boat(boat, (place && chart.pixelOf(place)) ?? [innerWidth / 2, innerHeight / 3]);
}

function escape(): void {
  popup.close();
  keyCard.close();
  plans.measure(null);
  survey.giveUp();
}

function click(place: Place, pixel: Pixel, touch: boolean): void {
  if (plans.measuring) return plans.measureTo(place, true);
  if (popup.isOpen) return popup.close();
  if (survey.isDrawing) return survey.add(place);
  if (!offer(pixel, touch)) menus.map(place, pixel);
}

/** A long press, or the other button: the same menus. */
function press(place: Place, pixel: Pixel): void {
  popup.close();
  if (survey.isDrawing) return survey.add(place);
  if (!offer(pixel, true)) menus.map(place, pixel);
}

function offer(pixel: Pixel, touch: boolean): boolean {
  const boat = fleet.at(pixel, touch ? REACH_TOUCH_PX : REACH_PX);
  const handle = boat ? null : plans.at(pixel, touch);
  const vessel = boat || handle ? null : others.at(pixel, touch ? REACH_TOUCH_PX : REACH_PX);
  if (boat) chosen(boat, pixel);
  else if (handle) menus.handle(handle, pixel);
  else if (vessel) tell(vessel, pixel);
  return boat !== null || handle !== null || vessel !== null;
}

function hover(place: Place, pixel: Pixel): void {
  if (plans.measuring) plans.measureTo(place, false);
  if (survey.isDrawing) survey.point(place);
  text(element("where"), whereWords(place, state));
  const over = fleet.at(pixel, REACH_PX) ?? plans.at(pixel, false) ?? others.at(pixel, REACH_PX);
  element("map").style.cursor = plans.measuring || survey.isDrawing ? "crosshair" : over ? "pointer" : "";
}

/** The time of the console, or of the replay. Ships and logs keep UTC; whoever looks out of the window has the local time. */
function tellTime(at: HTMLElement): void {
  const now = new Date(1000 * state.at_s);
  text(at.firstElementChild!, state.at_s ? `${now.toISOString().slice(11, 19)} UTC` : "");
  text(at.lastElementChild!, state.at_s ? now.toLocaleTimeString("en-GB", { hour: "2-digit", minute: "2-digit" }) : "");
}

/** How long ago the gateway was heard. */
function listen(): void {
  if (!net.online) text(element("offline").lastElementChild!, `last message ${ageWords(state.frameAge_s)} ago`);
}

/** The view is chosen once when the first boat is seen, and once more when its mission is, unless the operator has moved the map. */
function show(): void {
  if (moved || (placed && fitted)) return;
  const boat = state.boats.some((each) => position(each));
  const mission = boat && state.boats.some((each) => (state.aboardOf(each) ?? state.plan(each.id).mission).waypoints.length);
  if ((boat && !placed) || (mission && !fitted)) chart.fit(menus.everything());
  [placed, fitted] = [placed || boat, fitted || mission];
}

function pad(): void {
  const { offsetWidth, offsetHeight } = element("strips");
  const [bar, top] = [element("replay").offsetHeight, element("bar").offsetHeight];
  document.documentElement.style.setProperty("--bar", `${bar}px`);
  chart.setPadding(innerWidth <= 700 && innerHeight > 480 ? [offsetHeight + top + 20, 30, bar || 130, 30] : [40 + top, 110, 60 + bar, offsetWidth + 30]);
}

/** For tests and for the curious. `frames` and `drawings`: how often the map was drawn in the last second, and in all. */
const drawn: number[] = [];
let drawings = 0;
const ofLastSecond = (): number => {
  while (drawn.length && drawn[0]! < performance.now() - 1000) drawn.shift();
  return drawn.length;
};
chart.map.on("postrender", ({ frameState }) => frameState && ++drawings && drawn.push(performance.now()) && ofLastSecond());
Object.assign(window, {
  delfim: {
    pixel: (latitude_deg: number, longitude_deg: number) => chart.pixelOf({ latitude_deg, longitude_deg }),
    fit: (south: number, west: number, north: number, east: number) => {
      moved = true;
      chart.fit([
        { latitude_deg: south, longitude_deg: west },
        { latitude_deg: north, longitude_deg: east },
      ]);
      chart.map.renderSync();
    },
    theme: (name: Theme) => {
      setTheme(name);
      state.tell("theme");
    },
    at_s: () => state.at_s,
    drawn: () => ({ plan: state.plan(state.planning).mission.waypoints.length, aboard: (state.boat && state.aboardOf(state.boat)?.waypoints.length) ?? 0 }),
    online: () => state.hello !== null,
    land: () => land.polygons,
    harbours: () => land.harbours,
    ways: () => fleet.wayPoints,
    points: (boat: number) => fleet.points(boat),
    pieces: (boat: number) => fleet.pieces(boat),
    long: (boat: number) => fleet.long(boat),
    frames: ofLastSecond,
    names: () => fleet.names,
    drawings: () => drawings,
    numbers: () => plans.numbers,
    lines: () => plans.progress,
    crossed: () => state.crossed.get(state.planning) ?? null,
    why: (latitude_deg: number, longitude_deg: number) => chart.why({ latitude_deg, longitude_deg }),
    stations: () => plans.stations,
    depths: () => depths.counts,
    values: () => values.counts,
    areas: () => surveyed(state.plan(state.planning).mission).length,
    survey: () => survey.lines,
    loadArea: (name: string, words: string) => survey.load(new File([words], name)),
    wayHome: (boat: number) => wayHome.words(boat),
    reach: (boat: number) => wayHome.reaches(state.byId(boat)),
    alerts: () => alerts.states,
    vessels: () => state.vessels.map((each) => [each.name, watch.gravity(each)]),
  },
});
