const BUILT = "7e0a76fd";
const FILES = ["./","console.css?7e0a76fd","console.js?7e0a76fd","harbours.tsv","land.bin","manifest.webmanifest","b612-latin-400-normal.woff2","b612-latin-700-normal.woff2","icon-192.png","icon-512.png"];
// Wakes operators, and keeps the page itself, never a boat's state and never a command, so that it opens without its gateway. The network comes first:
// what is kept serves only where no answer comes. build.mjs puts BUILT and FILES before this.
const ANSWER_MS = 4000; // a network whose boat is out of reach says nothing for minutes
const NAME = `delfim-${BUILT}`;

self.addEventListener("install", (event) => {
  const fresh = FILES.map((file) => new Request(file, { cache: "reload" }));
  event.waitUntil(caches.open(NAME).then((kept) => kept.addAll(fresh)).then(() => self.skipWaiting()));
});

self.addEventListener("activate", (event) => {
  const old = (names) => Promise.all(names.filter((name) => name !== NAME).map((name) => caches.delete(name)));
  event.waitUntil(caches.keys().then(old).then(() => self.clients.claim()));
});

self.addEventListener("fetch", (event) => {
  const { pathname, search, origin } = new URL(event.request.url);
  const page = event.request.mode === "navigate" && pathname === "/";
  const file = page ? "./" : `${pathname.slice(1)}${search}`;
  if (event.request.method !== "GET" || origin !== location.origin || !FILES.includes(file)) return;
  event.respondWith(answered(event.request, file, page));
});

async function answered(request, file, page) {
  const kept = async () => (await (await caches.open(NAME)).match(file)) ?? Response.error();
  const late = page ? [new Promise((resolve) => setTimeout(resolve, ANSWER_MS))] : [];
  try {
    return (await Promise.race([fetch(request), ...late])) ?? (await kept());
  } catch {
    return kept();
  }
}

// What the boat says by the push service while no page is open.
self.addEventListener("push", (event) => {
  const { title, body, tag } = event.data.json();
  event.waitUntil(self.registration.showNotification(title, { body, tag, icon: "icon-192.png", requireInteraction: true }));
});

self.addEventListener("notificationclick", (event) => {
  event.notification.close();
  const look = (pages) => (pages.length ? pages[0].focus() : self.clients.openWindow("./"));
  event.waitUntil(self.clients.matchAll({ type: "window", includeUncontrolled: true }).then(look));
});
