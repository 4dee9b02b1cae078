// Elements in one line. What is written is compared first: a browser lays out and paints anew what was written, be it the same.

type Child = Node | string | null | undefined | false;
type Made<K extends keyof HTMLElementTagNameMap> = HTMLElementTagNameMap[K];

/** `make("div.row", child, "text")` */
export function make<K extends keyof HTMLElementTagNameMap>(what: K | `${K}.${string}`, ...children: Child[]): Made<K> {
  const [tag, ...classes] = what.split(".");
  const element = document.createElement(tag!) as Made<K>;
  element.className = classes.join(" ");
  element.append(...children.filter((each): each is Node | string => Boolean(each)));
  return element;
}

export function text(element: Element, words: string): void {
  if (element.textContent !== words) element.textContent = words;
}

export function attribute(element: Element, name: string, value: string): void {
  if (element.getAttribute(name) !== value) element.setAttribute(name, value);
}

export function hide(element: HTMLElement, on: boolean): void {
  if (element.hidden !== on) element.hidden = on;
}

export function disable(button: HTMLButtonElement, on: boolean): void {
  if (button.disabled !== on) button.disabled = on;
}
