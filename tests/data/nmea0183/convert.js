// node convert.js RECORDING SOURCE... > SENTENCES
// Sentences of NMEA 0183 from a candump of NMEA 2000, each behind the stamp of the frame that completed it: canboatjs decodes,
// n2k-signalk names the values, signalk-to-nmea0183 makes the sentences. README.md has the versions.
const fs = require("fs")
const path = require("path")
const zlib = require("zlib")
const { FromPgn } = require("@canboat/canboatjs")
const { N2kMapper } = require("@signalk/n2k-signalk")

const [, , recording, ...sources] = process.argv
const CAUSES = {
  GGA: "navigation.gnss.methodQuality", // 129029, the one message that has a position with its time
  RMC: "navigation.gnss.methodQuality",
  HDG: "navigation.headingMagnetic",
  ROT: "navigation.rateOfTurn",
}
const makers = Object.keys(CAUSES).map((name) =>
  require(path.resolve(`node_modules/@signalk/signalk-to-nmea0183/dist/sentences/${name}.js`)).default({}),
)
const values = {}
const parser = new FromPgn()
const mapper = new N2kMapper({})
let stamp = ""

parser.on("pgn", (pgn) => {
  if (!sources.includes(String(pgn.src))) return
  const updated = new Set()
  for (const update of mapper.toDelta(pgn)?.updates ?? [])
    for (const { path: name, value } of update.values ?? []) {
      values[name] = value
      updated.add(name)
    }
  if (values["navigation.datetime"] === undefined) return // the maker would take the time of today
  for (const maker of makers) {
    if (!updated.has(CAUSES[maker.sentence])) continue
    const given = maker.keys.map((key, i) => values[key] ?? (maker.defaults ?? [])[i])
    const sentence = given.includes(undefined) ? undefined : maker.f(...given)
    if (sentence) console.log(`${stamp} ${sentence.trim()}`)
  }
})
const file = fs.readFileSync(recording)
for (const row of (recording.endsWith(".gz") ? zlib.gunzipSync(file) : file).toString().split("\n"))
  if (row.startsWith("(")) {
    stamp = row.split(" ")[0]
    parser.parseString(row)
  }
