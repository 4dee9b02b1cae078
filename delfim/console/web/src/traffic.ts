// Other vessels in words: how many are heard and how long ago, who keeps clear of whom, and a table by the time of the nearest approach.
import { attribute, hide, make, text } from "./dom";
import { position } from "./fleet";
import { bearing, bearing_deg, distance_m, metres } from "./geo";
import { isThing, secondsWords, tcpaWords } from "./others";
import type { State } from "./state";
import { worst } from "./watch";
import type { Watch } from "./watch";
import type { Boat, Vessel } from "./wire";

const ROWS_MOST = 10;
const KEPT = "delfim.vessels";

export class Traffic {
  private readonly line = make("button.said");
  private readonly orders = make("div.orders");
  private readonly table = make("table");
  private readonly note = make("button.main", "Acknowledge");
  private ordered = "";
  private open = localStorage.getItem(KEPT) === "open";

  constructor(
    private readonly box: HTMLElement,
    private readonly state: State,
    private readonly watch: Watch,
    private readonly chosen: (vessel: Vessel, at: [number, number]) => void,
  ) {
    for (const each of [this.line, this.note]) each.tabIndex = -1;
    this.line.addEventListener("click", () => {
      this.open = !this.open;
      localStorage.setItem(KEPT, this.open ? "open" : "closed");
      this.draw();
    });
    this.note.addEventListener("click", () => watch.acknowledge());
    this.note.hidden = true;
    this.note.title = "the sound stops; the vessel stays red (K)";
    box.append(this.line, this.orders, this.table, this.note);
    this.table.addEventListener("pointerup", (event) => this.choose(event));
    state.on(["vessels"], () => this.draw());
    state.on(["boats"], () => {
      this.tell();
      this.drawOrders();
    });
    this.tell();
    setInterval(() => state.nothingArrives && this.tell(), 500);
  }

  private draw(): void {
    const { vessels } = this.state;
    const grave = vessels.filter((each) => this.watch.gravity(each) !== "none");
    const alarming = this.watch.alarming;
    attribute(this.box, "data-state", alarming.length ? "alarm" : grave.some((each) => this.watch.gravity(each) === "danger") ? "danger" : grave.length ? "near" : "calm");
    this.tell();
    this.drawOrders();
    const shown = this.open ? vessels.slice(0, ROWS_MOST) : grave.slice(0, ROWS_MOST);
    hide(this.table, !shown.length);
    hide(this.note, !alarming.length);
    if (!shown.length) return this.table.replaceChildren();
    const heads = make("tr", make("th", "vessel"), make("th", "away"), make("th", "CPA"), make("th", "TCPA"), make("th", "age"));
    const more = (this.open ? vessels.length : grave.length) - shown.length;
    this.table.replaceChildren(heads, ...shown.map((each) => this.row(each)), ...(more > 0 ? [make("tr", make("td", `and ${more} more, later`))] : []));
  }

  /** Rows are made anew each second, so a click is taken by the table. */
  private choose(event: PointerEvent): void {
    const key = (event.target as Element).closest("tr")?.dataset["vessel"];
    const vessel = this.state.vessels.find((each) => each.key === key);
    if (vessel) this.chosen(vessel, [event.clientX, event.clientY]);
  }

  private drawOrders(): void {
    const { boats, vessels } = this.state;
    hide(this.box, !boats.length);
    const words = boats.flatMap((boat) => guardWords(boat, boats.length > 1, vessels.length > 0));
    if (words.join() === this.ordered) return;
    this.ordered = words.join();
    this.orders.replaceChildren(...words.map((each) => make("p", each)));
  }

  private row(vessel: Vessel): HTMLElement {
    const first = worst(vessel);
    const boat = first && this.state.byId(first.boat);
    const from = boat && position(boat);
    const away = from ? `${metres(distance_m(from, vessel))} ${bearing(bearing_deg(from, vessel))}` : "";
    const whom = boat && this.state.boats.length > 1 ? make("small", boat.name) : null;
    const size = vessel.size_known ? null : make("small", "size unknown");
    const row = make(
      "tr",
      make("td", make("b", vessel.name), whom, size),
      make("td", away),
      make("td", first?.cpa_m == null ? "–" : `${first.cpa_m.toFixed(0)} m`),
      make("td", first ? tcpaWords(first.tcpa_s) : "–"),
      make("td", vessel.lost ? `lost ${secondsWords(vessel.age_s)}` : secondsWords(vessel.age_s)),
    );
    row.dataset["danger"] = this.watch.gravity(vessel);
    row.dataset["lost"] = String(vessel.lost);
    row.dataset["vessel"] = vessel.key;
    return row;
  }

  /** Silence is no clear water: the line says so always. */
  private tell(): void {
    const { vessels, heard_s } = this.state;
    const lean = this.state.boats.length > 0 && this.state.boats.every(({ link }) => link.profile === "lean");
    const seen = vessels.filter((each) => isThing(each) || each.kind === "payload").length;
    const ships = vessels.length - seen;
    const count = `${ships} target${ships === 1 ? "" : "s"}`;
    const words = heard_s === null ? (lean ? "AIS: not told on a lean link." : "AIS: nobody heard yet.") : `AIS: ${count}, last report ${secondsWords(heard_s)} ago.`;
    text(this.line, `${words} Sees only who transmits.${seen ? ` Seen by programs: ${seen}.` : ""}`);
  }
}

/** What a boat does for others, and whether it would. */
function guardWords(boat: Boat, several: boolean, meets: boolean): string[] {
  const who = several ? `${boat.name}: ` : "";
  if (boat.order) return [`${who}${boat.order.words}`];
  if (!meets || !boat.guard || boat.guard === "on") return [];
  return [`${who}${boat.guard === "off" ? `does not keep clear of others in ${boat.mode ?? "this mode"}` : "cannot keep clear of others: see the messages"}`];
}
