// The WebSocket to the gateway: passes messages on, numbers requests, returns their answers, and reconnects by itself.
import type { Heard, Said, Streamed } from "./wire";

const RETRY_MS = 1000;
const SILENT_MS = 3000; // the gateway speaks several times a second; a socket that is silent for so long is dead

export interface Answer {
  ok: boolean;
  reason: string;
}

export class Net {
  private socket: WebSocket | null = null;
  private seq = 0;
  private heardAt = performance.now();
  private waiting = new Map<number, (answer: Answer) => void>();

  constructor(
    private readonly heard: (message: Heard) => void,
    private readonly changed: (online: boolean) => void,
  ) {
    this.connect();
    setInterval(() => this.watch(), 500);
  }

  get online(): boolean {
    return this.socket?.readyState === WebSocket.OPEN;
  }

  /** Resolves when the vehicle, or the gateway for it, has answered. */
  ask(request: Said): Promise<Answer> {
    const seq = ++this.seq;
    if (!this.send({ ...request, seq })) return Promise.resolve({ ok: false, reason: "the console is offline" });
    return new Promise((resolve) => this.waiting.set(seq, resolve));
  }

  stream(message: Streamed): void {
    this.send(message);
  }

  private send(message: object): boolean {
    if (!this.online) return false;
    this.socket!.send(JSON.stringify(message));
    return true;
  }

  private connect(): void {
    const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws${location.search}`);
    this.socket = socket;
    this.heardAt = performance.now();
    socket.onopen = () => this.changed(true);
    socket.onmessage = (event) => this.hear(String(event.data));
    socket.onclose = () => this.lost(socket);
  }

  /** A message that cannot be taken is dropped, and the page says so (failed.ts); the others are not affected. */
  private hear(text: string): void {
    this.heardAt = performance.now();
    try {
      this.take(JSON.parse(text) as Heard);
    } catch (error) {
      reportError(error);
    }
  }

  private take(message: Heard): void {
    if (message.t === "answer") {
      if (message.stage === "sent") return;
      this.waiting.get(message.seq)?.(message);
      this.waiting.delete(message.seq);
    }
    this.heard(message);
  }

  private watch(): void {
    if (this.online && performance.now() - this.heardAt > SILENT_MS) this.lost(this.socket!);
  }

  private lost(socket: WebSocket): void {
    if (socket !== this.socket) return;
    this.socket = null;
    socket.onclose = null;
    socket.close();
    for (const resolve of this.waiting.values()) resolve({ ok: false, reason: "the console went offline" });
    this.waiting.clear();
    this.changed(false);
    setTimeout(() => this.connect(), RETRY_MS);
  }
}
