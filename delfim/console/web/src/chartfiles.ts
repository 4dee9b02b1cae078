// Official charts that are dropped on the page, with their updates or as an exchange set: the gateway reads them, all pages show them, and a boat may get one as its field.
import type { Actions } from "./actions";
import type { Chart, Pixel } from "./chart";
import { position } from "./fleet";
import type { Messages } from "./messages";
import type { Entry, Popup } from "./popup";
import { posted } from "./sending";
import type { State } from "./state";

const ASIDE: Pixel = [Infinity, 60]; // the menu must not cover the chart

interface Told {
  name: string;
  words: string;
  extent: [west: number, south: number, east: number, north: number];
}

/** Whether a file is a cell, an update, a catalogue or an exchange set. */
export const isChart = ({ name }: File): boolean => /\.(\d{3}|zip)$/i.test(name);

export class ChartFiles {
  constructor(
    private readonly chart: Chart,
    private readonly popup: Popup,
    private readonly state: State,
    private readonly messages: Messages,
    private readonly actions: Actions,
  ) {}

  /** The field's middle is the boat, or what is in sight, where the chart covers it. */
  async take(files: File[]): Promise<void> {
    const form = new FormData();
    for (const each of files) form.append("file", each, each.name);
    this.messages.say(null, 6, `chart of ${files[0]!.name} is being read`);
    const boat = this.state.boat && position(this.state.boat);
    const [middle] = this.chart.middle();
    const at = boat ? [boat, middle] : [middle];
    const told = await posted<Told>(`chart?at=${at.map((each) => `${each.latitude_deg},${each.longitude_deg}`).join(";")}`, form);
    if (!told.name) return this.messages.say(null, 3, `chart refused: ${told.refused}`);
    this.messages.say(null, 6, told.words!);
    const [west, south, east, north] = told.extent!;
    const corners = [[south, west] as const, [north, east] as const].map(([latitude_deg, longitude_deg]) => ({ latitude_deg, longitude_deg }));
    if (middle.latitude_deg < south || middle.latitude_deg > north || middle.longitude_deg < west || middle.longitude_deg > east) this.chart.fit(corners);
    if (!this.popup.isOpen) await this.offer(told.name);
  }

  /** The charts of this console that a boat may get. */
  menu(): Entry[] {
    const charts = this.state.backgrounds.filter(({ kind }) => kind === "dangers");
    return charts.length ? charts.map(({ name }) => ({ title: name, do: () => void this.offer(name) })) : [{ title: "None", refuse: "drop a cell (.000) with its updates, or an exchange set (.zip), on the page" }];
  }

  /** Offers to send a chart to the boat, with the reason where it cannot be. */
  private async offer(name: string): Promise<void> {
    const boat = this.state.boat;
    const why = boat ? await this.actions.sendChart(boat.id, name, "unsent") : "no boat is heard";
    const send = { title: `Send it to ${boat?.name ?? "a boat"}`, note: "as the water that it keeps out of, from its next start on", refuse: why || undefined, do: () => void (boat && this.actions.sendChart(boat.id, name, "chart")) };
    this.popup.menu(ASIDE, { title: name, note: "not for navigation" }, [send]);
  }
}
