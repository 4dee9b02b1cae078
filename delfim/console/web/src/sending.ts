// Files from the operator's computer: one is chosen, and the gateway reads it.

/** Asks for a file with one of these endings. */
export function chosen(endings: string, take: (file: File) => void): void {
  const input = document.createElement("input");
  Object.assign(input, { type: "file", accept: endings });
  input.addEventListener("change", () => input.files?.[0] && take(input.files[0]));
  input.click();
}

/** What the gateway reads in a file, or why it is refused. `kind`: of what there may be in it, a path of the gateway. */
export async function sent<Told>(kind: string, file: File): Promise<Partial<Told> & { refused?: string }> {
  return posted(`${kind}?name=${encodeURIComponent(file.name)}`, file);
}

/** What the gateway answers to what a page sends. */
export async function posted<Told>(url: string, body: File | FormData): Promise<Partial<Told> & { refused?: string }> {
  const answer = await fetch(url, { method: "POST", body }).catch(() => null);
  return answer?.ok ? ((await answer.json()) as Partial<Told>) : { refused: "the console does not take it" } as Partial<Told> & { refused: string };
}
