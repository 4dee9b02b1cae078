// The helm of MOOS-IvP in lock step, for `python -m bench avoiding`: its engine, BHV_Waypoint along a line, and BHV_AvdColregsV22 for
// each ship, without its data base and its clock. What pContactMgr and pHelmIvP's mail do is done here: each ship is in the ledger.
//
// moosavoid SPEED COUNT X Y PARAMETERS WAY   X, Y: the end of the line, m to the east and the north; PARAMETERS of BHV_AvdColregsV22,
//                                            as "pwt_outer_dist=540 max_util_cpa_dist=120"; WAY: those of BHV_Waypoint, as "lead=20"
// It reads lines "TIME X Y HEADING SPEED", each followed by "X Y HEADING SPEED" of all COUNT ships, in s, m, degrees and m/s, and
// answers each with "HEADING SPEED", or "none".

#include <cstdio>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

#include "BHV_AvdColregsV22.h"
#include "BHV_Waypoint.h"
#include "BehaviorSet.h"
#include "HelmEngine.h"
#include "InfoBuffer.h"
#include "LedgerSnap.h"

namespace {

void take(IvPBehavior& behavior, const std::string& name, const std::string& value) {
  if (!behavior.setParam(name, value) && !behavior.IvPBehavior::setParam(name, value)) {
    std::fprintf(stderr, "moosavoid: %s=%s is not taken\n", name.c_str(), value.c_str());
    std::exit(2);
  }
}

void take_all(IvPBehavior& behavior, const char* words) {
  std::istringstream parameters(words);
  for (std::string each; parameters >> each;) take(behavior, each.substr(0, each.find('=')), each.substr(each.find('=') + 1));
}

void begin(IvPBehavior& behavior, const std::string& name, InfoBuffer& known, LedgerSnap& ships) {
  behavior.setInfoBuffer(&known);
  behavior.setLedgerSnap(&ships);
  behavior.IvPBehavior::setParam("name", name);
  behavior.IvPBehavior::setParam("us", "boat");
}

std::string ship(int number) { return "ship" + std::to_string(number); }

}  // namespace

int main(int count_of_words, char** words) {
  if (count_of_words != 7) return 2;
  const std::string speed = words[1], end = std::string(words[3]) + "," + words[4];
  const int ships = std::atoi(words[2]);
  std::ostream answers(std::cout.rdbuf());
  std::cout.rdbuf(nullptr);  // the helm talks

  IvPDomain domain;
  domain.addDomain("course", 0, 359, 360);
  domain.addDomain("speed", 0, std::stod(speed), 16);
  InfoBuffer known;
  LedgerSnap ledger;
  BehaviorSet behaviors;
  behaviors.setDomain(domain);
  behaviors.connectInfoBuffer(&known);
  behaviors.connectLedgerSnap(&ledger);
  behaviors.setOwnship("boat");

  auto* way = new BHV_Waypoint(domain);
  begin(*way, "way", known, ledger);
  for (const auto& [name, value] : std::vector<std::pair<std::string, std::string>>{
           {"points", "0,0:" + end}, {"speed", speed}, {"capture_radius", "10"}, {"slip_radius", "30"}, {"pwt", "100"}})
    take(*way, name, value);
  take_all(*way, words[6]);
  way->onSetParamComplete();
  behaviors.addBehavior(way);
  for (int i = 0; i < ships; ++i) {
    auto* avoid = new BHV_AvdColregsV22(domain);
    begin(*avoid, "avoid_" + ship(i), known, ledger);
    take(*avoid, "contact", ship(i));
    take(*avoid, "pwt", "500");
    take(*avoid, "completed_dist", "100000");  // it is there from the start, as pContactMgr would have it nearer by
    take_all(*avoid, words[5]);
    avoid->onSetParamComplete();
    behaviors.addBehavior(avoid);
  }

  HelmEngine engine(domain, &known, &ledger);
  engine.setBehaviorSet(&behaviors);
  double t, x, y, heading, mps;
  while (std::cin >> t >> x >> y >> heading >> mps) {
    known.setCurrTime(t);
    ledger.setCurrTimeUTC(t);
    known.setValue("NAV_X", x, t);
    known.setValue("NAV_Y", y, t);
    known.setValue("NAV_HEADING", heading, t);
    known.setValue("NAV_SPEED", mps, t);
    for (int i = 0; i < ships; ++i) {
      double sx, sy, sh, sv;
      std::cin >> sx >> sy >> sh >> sv;
      ledger.setX(ship(i), sx);
      ledger.setY(ship(i), sy);
      ledger.setHdg(ship(i), sh);
      ledger.setSpd(ship(i), sv);
      ledger.setUTC(ship(i), t);
      ledger.setUTCAge(ship(i), 0.0);
    }
    const HelmReport report = engine.determineNextDecision(&behaviors, t);
    if (report.hasDecision("course") && report.hasDecision("speed"))
      answers << report.getDecision("course") << " " << report.getDecision("speed") << std::endl;
    else
      answers << "none" << std::endl;
  }
}
