// A vehicle's file of one's own boat by questions, one after the other, or a file that is checked. The gateway asks and checks; nothing of it is known here.
import { make, text } from "./dom";
import { chosen, posted } from "./sending";

interface Told {
  question: { option: string; words: string; default: string; kinds: Record<string, string>; wrong?: string };
  files: Record<string, string>;
  checked: string;
}

export class NewBoat {
  private answers: [option: string, answer: string][] = [];
  private next = () => {};
  private readonly body = make("div");
  private readonly back = make("button.plain", "Back");
  private readonly box: HTMLElement;

  constructor(parent: HTMLElement) {
    const button = (title: string, act: () => void, made = make("button.plain", title)) => {
      made.tabIndex = -1;
      made.addEventListener("click", act);
      return made;
    };
    button("", () => void this.ask(this.answers.slice(0, -1)), this.back);
    const check = button("Check a file…", () => chosen(".toml", (file) => void this.ask([], file)));
    this.box = make("div.card.log.panes", make("header", make("h2", "A boat’s file"), this.back, check, button("Close", () => this.close())), this.body);
    this.box.id = "newboat";
    this.box.setAttribute("role", "dialog");
    this.box.setAttribute("aria-label", "A boat’s file");
    this.box.hidden = true;
    parent.append(this.box);
  }

  open(): void {
    this.box.hidden = false;
    void this.ask([]);
  }

  close(): boolean {
    const was = !this.box.hidden;
    this.box.hidden = true;
    return was;
  }

  /** No key is an order while the form is open; Enter answers. */
  takes(key: string): boolean {
    if (this.box.hidden || key === "Escape") return false;
    if (key === "Enter") this.next();
    return true;
  }

  private async ask(answers: [string, string][], file?: File): Promise<void> {
    this.answers = answers;
    this.next = () => {};
    this.back.hidden = !answers.length;
    this.body.replaceChildren(make("p", "…"));
    const told = await posted<Told>(`new?name=${file ? "checked.toml" : "a.json"}`, file ?? new File([JSON.stringify(Object.fromEntries(answers))], "a"));
    if (told.question) this.draw(told.question, answers);
    else {
      const files = Object.entries(told.files ?? {});
      this.body.replaceChildren(make("p.said", told.refused ?? told.checked), ...files.map(([name, words]) => saved(name, words)), ...files.map(([, words]) => make("pre", words)));
    }
  }

  private draw({ option, words, default: usual, kinds, wrong }: Told["question"], answers: [string, string][]): void {
    const answer = (value: string) => void this.ask([...answers.filter(([each]) => each !== option), [option, value]]);
    const rows = Object.entries(kinds).map(([kind, about]) => {
      const row = make("button.item", make("span.title", kind, make("small", about)));
      row.classList.toggle("focus", kind === usual); // what Enter chooses
      row.addEventListener("click", () => answer(kind));
      return row;
    });
    const field = make("input");
    Object.assign(field, { type: "text", placeholder: usual, maxLength: 100, autocomplete: "off", spellcheck: false });
    field.setAttribute("aria-label", words);
    const go = make("button.main", "Next");
    this.next = () => answer(field.value);
    go.addEventListener("click", () => this.next());
    const why = make("p.bad");
    text(why, wrong ?? "");
    this.body.replaceChildren(make("p", make("b", words)), why, ...(rows.length ? rows : [make("p", field, go)]));
    if (!rows.length) field.focus();
    else this.next = () => answer(usual);
  }
}

function saved(name: string, words: string): HTMLElement {
  const link = make("a.main", `Save ${name}`);
  link.href = URL.createObjectURL(new Blob([words]));
  link.download = name;
  return link;
}
