// Who commands, where operators have names: said on every page, taken, offered and accepted. The page answers each word of the gateway,
// which is the proof that whoever commands knows it.
import { attribute, make, text } from "./dom";
import type { Net } from "./net";
import type { Entry, Popup } from "./popup";
import type { Hand, Heard } from "./wire";

export type Word = Extract<Heard, { t: "bridge" }>;

export class Bridge {
  private word: Word | null = null;
  private asked = 0; // the page whose offer was said last
  private readonly button = make("button.plain");

  constructor(
    bar: HTMLElement,
    private readonly net: Net,
    private readonly popup: Popup,
    private readonly say: (severity: number, words: string) => void,
    private readonly told: (name: string) => void, // whose page this is
  ) {
    this.button.id = "bridge";
    this.button.tabIndex = -1;
    this.button.hidden = true;
    this.button.addEventListener("click", () => this.open());
    bar.append(this.button);
  }

  take(word: Word): void {
    this.net.stream({ t: "here", n: word.n, grant: word.granted === word.you ? word.grant : 0 });
    const [was, is] = [this.word && mine(this.word), mine(word)];
    if (was && !is) this.say(4, "You command no longer");
    const offering = word.offered === word.you ? word.holder : 0;
    if (offering && offering !== this.asked) this.say(4, `${named(word, word.holder)} offers you the command`);
    this.asked = offering;
    this.word = word;
    this.draw(word);
  }

  private draw(word: Word): void {
    this.told(named(word, word.you));
    const offered = word.offered === word.you;
    const words = offered ? `${named(word, word.holder)} offers you the command` : mine(word) ? "You command" : word.holder ? `${named(word, word.holder)} commands` : "Nobody commands";
    this.button.hidden = false;
    text(this.button, words);
    attribute(this.button, "data-state", offered ? "offered" : mine(word) ? "mine" : word.holder ? "other" : "nobody");
    attribute(this.button, "title", `You are ${named(word, word.you)}`);
  }

  private open(): void {
    if (!this.word) return;
    const { word } = this;
    const { left, bottom } = this.button.getBoundingClientRect();
    this.popup.menu([left, bottom], { title: named(word, word.you), note: word.pages.find(({ page }) => page === word.you)?.role ?? "" }, this.entries(word));
  }

  private entries(word: Word): Entry[] {
    const hand = (title: string, what: Hand["do"], refuse: string | false, page = 0): Entry => ({ title, refuse, do: () => void this.ask({ t: "handover", do: what, page }) });
    const watches = word.pages.find(({ page }) => page === word.you)?.role === "watch" && "your role is to watch";
    if (word.offered === word.you) return [hand("Accept the command", "accept", false), hand("Decline", "leave", false)];
    if (!mine(word)) return [hand("Take the command", "take", watches || (word.holder > 0 && `${named(word, word.holder)} commands, and may offer it`))];
    const others = word.pages.filter(({ page }) => page !== word.you);
    const offers = others.map(({ page, name, role, carries }) => hand(`Offer it to ${name}`, "offer", (role === "watch" && "may only watch") || (!carries && "that link cannot carry a stop"), page));
    if (word.offered) offers.unshift(hand("Withdraw the offer", "offer", false));
    return [...offers, ...(offers.length ? (["line"] as const) : []), hand("Leave the command to nobody", "leave", false)];
  }

  private async ask(hand: Hand): Promise<void> {
    const { ok, reason } = await this.net.ask(hand);
    if (!ok) this.say(4, reason);
  }
}

const mine = ({ you, holder, granted }: Word): boolean => you === holder || you === granted;

const named = (word: Word, page: number): string => word.pages.find((each) => each.page === page)?.name ?? "Somebody";
