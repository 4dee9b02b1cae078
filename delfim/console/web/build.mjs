// Bundles the page into the folder named on the command line (../page without one): console.js, console.css, index.html,
// sw.js, manifest.webmanifest, icons, land.bin, harbours.tsv (Natural Earth's 1:10m ports, public domain), LICENSES.txt, sources.json.
// The same sources and the same lock file give the same bytes.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { copyFileSync, mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { land } from "./land.mjs";

const here = import.meta.dirname;
const out = process.argv[2] ?? join(here, "..", "page");
mkdirSync(out, { recursive: true });
// What OpenLayers names and this page never calls is left out: 40 kB of controls, interactions and styles in words.
const never = (name) => `export const ${name} = () => { throw new Error("${name} is not in this page"); };`;
const spared = {
  name: "spared",
  setup(work) {
    work.onLoad({ filter: /\/ol\/(control|interaction)\/defaults\.js$/ }, () => ({ contents: never("defaults") }));
    work.onLoad({ filter: /\/ol\/render\/canvas\/style\.js$/ }, () => ({ contents: never("flatStyleLikeToStyleFunction") }));
  },
};
const { metafile } = await build({
  entryPoints: { console: join(here, "src/main.ts") },
  outdir: out,
  absWorkingDir: here,
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  charset: "utf8",
  legalComments: "none",
  metafile: true,
  plugins: [spared],
  preserveSymlinks: true, // a folder of packages that is a link is named as it stands here: the licences are found by it
  loader: { ".woff2": "file" },
  assetNames: "[name]",
});
copyFileSync(join(here, "src/tokens.css"), join(process.argv[2] ?? join(here, "../../services/page"), "tokens.css")); // the boat's page has the same colours
copyFileSync(join(here, "harbours.tsv"), join(out, "harbours.tsv"));
copyFileSync(join(here, "src/manifest.webmanifest"), join(out, "manifest.webmanifest"));
for (const name of readdirSync(join(here, "icon"))) copyFileSync(join(here, "icon", name), join(out, name));
writeFileSync(join(out, "land.bin"), land(JSON.parse(readFileSync(join(here, "node_modules/world-atlas/land-10m.json"), "utf8"))));

// The page names its program and its style with a digest, and so does what keeps it offline: parts of two builds never meet.
const parts = ["console.css", "console.js", "harbours.tsv", "land.bin"];
const built = createHash("sha256");
for (const name of parts) built.update(readFileSync(join(out, name)));
const digest8 = built.digest("hex").slice(0, 8);
const index = readFileSync(join(here, "src/index.html"), "utf8").replace(/console\.(css|js)"/g, `console.$1?${digest8}"`);
writeFileSync(join(out, "index.html"), index);
const kept = ["./", `console.css?${digest8}`, `console.js?${digest8}`, "harbours.tsv", "land.bin", "manifest.webmanifest"];
kept.push(...readdirSync(out).filter((name) => name.endsWith(".woff2") || name.endsWith(".png")).sort());
const worker = readFileSync(join(here, "src/sw.js"), "utf8");
writeFileSync(join(out, "sw.js"), `const BUILT = "${digest8}";\nconst FILES = ${JSON.stringify(kept)};\n${worker}`);

const packages = new Set(["world-atlas"]);
for (const file of Object.keys(metafile.inputs)) {
  const found = file.match(/^node_modules\/((?:@[^/]+\/)?[^/]+)\//);
  if (found) packages.add(found[1]);
}
const licences = [...packages].sort().map((name) => {
  const folder = join(here, "node_modules", name);
  const { version, license } = JSON.parse(readFileSync(join(folder, "package.json"), "utf8"));
  const file = readdirSync(folder).find((each) => /^licen[cs]e/i.test(each));
  const text = file ? readFileSync(join(folder, file), "utf8").trim() : license;
  return `${name} ${version} (${license})\n\n${text}\n`;
});
licences.push(`B612 (OFL-1.1)\n\n${readFileSync(join(here, "face/OFL.txt"), "utf8").trim()}\n`);
writeFileSync(join(out, "LICENSES.txt"), licences.join("\n" + "-".repeat(78) + "\n\n"));

// What it was made of, so that a test can tell a bundle from before the last change.
const sources = ["build.mjs", ...readdirSync(join(here, "face")).map((name) => `face/${name}`), ...readdirSync(join(here, "icon")).map((name) => `icon/${name}`), "harbours.tsv", "land.mjs", "package-lock.json", ...readdirSync(join(here, "src")).map((name) => `src/${name}`)].sort();
const digest = (name) => createHash("sha256").update(readFileSync(join(here, name))).digest("hex");
writeFileSync(join(out, "sources.json"), JSON.stringify(Object.fromEntries(sources.map((name) => [name, digest(name)])), null, 1) + "\n");
