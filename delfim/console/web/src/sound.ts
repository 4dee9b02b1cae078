// Audible warnings: two falling tones, twice, for a grave message, one tone for a warning. Silent until the page was first touched.

const KEPT = "delfim.sound";

export class Sound {
  on = localStorage.getItem(KEPT) !== "off";
  private context: AudioContext | null = null;

  constructor() {
    const wake = () => {
      if (!navigator.userActivation?.hasBeenActive) return; // a finger that comes down does not count yet
      this.context ??= new AudioContext();
      void this.context.resume();
    };
    for (const event of ["pointerdown", "pointerup", "keydown"]) window.addEventListener(event, wake, { capture: true });
  }

  toggle(): void {
    this.on = !this.on;
    localStorage.setItem(KEPT, this.on ? "on" : "off");
    if (this.on) this.warn();
  }

  alarm(): void {
    this.tone(880, 0);
    this.tone(587, 0.22);
    this.tone(880, 0.44);
    this.tone(587, 0.66);
  }

  warn(): void {
    this.tone(660, 0);
  }

  private tone(hertz: number, after_s: number): void {
    const context = this.context;
    if (!this.on || context?.state !== "running") return;
    const [oscillator, gain, at] = [context.createOscillator(), context.createGain(), context.currentTime + after_s];
    oscillator.frequency.value = hertz;
    gain.gain.setValueAtTime(0, at);
    gain.gain.linearRampToValueAtTime(0.25, at + 0.02);
    gain.gain.exponentialRampToValueAtTime(0.001, at + 0.2);
    oscillator.connect(gain).connect(context.destination);
    oscillator.start(at);
    oscillator.stop(at + 0.21);
  }
}
