// A client of a MOOS community for `python -m bench peers`. It says what the community's controller orders, and when.
//
// moosprobe PORT          start the mission; a line "THRUST NANOSECONDS" for each order of thrust, by the clock of the system
// moosprobe PORT HZ TURNS play the navigation of a boat beside its line, at so many messages a second; now and then it is found on
//                         the other side. A line for each time: microseconds from that message to the first order of rudder that way.

#include <chrono>
#include <condition_variable>
#include <cstdio>
#include <cstdlib>
#include <mutex>
#include <thread>
#include <unistd.h>

#include "MOOS/libMOOS/Comms/MOOSAsyncCommClient.h"

namespace {

using Clock = std::chrono::steady_clock;

constexpr double aside_m = 5.0;
constexpr int settled = 10;  // messages of navigation between two turns

MOOS::MOOSAsyncCommClient client;
std::mutex mutex;
std::condition_variable changed;
double rudder = 0.0;
Clock::time_point rudder_at;
std::FILE* told = nullptr;  // for results alone: the library prints what it does to standard output

bool connected(void* name) {
  return client.Register(static_cast<const char*>(name), 0.0);
}

bool heard(void*) {
  MOOSMSG_LIST mail;
  client.Fetch(mail);
  for (auto& each : mail) {
    if (each.GetKey() == "DESIRED_THRUST") {
      const auto now = std::chrono::system_clock::now().time_since_epoch();
      std::fprintf(told, "%g %lld\n", each.GetDouble(), static_cast<long long>(std::chrono::nanoseconds(now).count()));
      std::fflush(told);
    } else {
      const std::lock_guard<std::mutex> held(mutex);
      rudder = each.GetDouble();
      rudder_at = Clock::now();
      changed.notify_all();
    }
  }
  return true;
}

void start() {
  client.Notify("DEPLOY", "true");
  client.Notify("MOOS_MANUAL_OVERRIDE", "false");
  client.Notify("MOOS_MANUAL_OVERIDE", "false");  // as older programs spell it
}

void navigation(double x_m) {
  client.Notify("NAV_X", x_m);
  client.Notify("NAV_Y", 0.0);
  client.Notify("NAV_HEADING", 0.0);
  client.Notify("NAV_SPEED", 1.5);
}

// How long after now the first rudder to this side comes, in microseconds; below zero: not within ten seconds.
double turned(bool starboard, Clock::time_point since) {
  std::unique_lock<std::mutex> held(mutex);
  const bool came = changed.wait_for(held, std::chrono::seconds(10), [&] { return rudder_at > since && (rudder > 0) == starboard && rudder != 0.0; });
  return came ? std::chrono::duration<double, std::micro>(rudder_at - since).count() : -1.0;
}

}  // namespace

int main(int count, char** words) {
  if (count != 2 && count != 4) return 2;
  told = fdopen(dup(STDOUT_FILENO), "w");
  if (told == nullptr || dup2(STDERR_FILENO, STDOUT_FILENO) < 0) return 1;
  char thrust[] = "DESIRED_THRUST", side[] = "DESIRED_RUDDER";
  client.SetOnConnectCallBack(connected, count == 2 ? thrust : side);
  client.SetOnMailCallBack(heard, nullptr);
  client.SetQuiet(true);
  client.Run("localhost", std::atoi(words[1]), "moosprobe");
  if (!client.WaitUntilConnected(60000)) return 1;
  if (count == 2) {
    for (;;) {  // a helm that is not there yet does not hear it
      start();
      std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
  }
  const auto period = std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(1.0 / std::atof(words[2])));
  double x_m = aside_m;
  for (int i = 0; i < 5 * settled; i++) {  // under way
    start();
    navigation(x_m);
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  for (int turn = 0; turn < std::atoi(words[3]); turn++) {
    for (int i = 0; i < settled; i++) {
      std::this_thread::sleep_for(period);
      navigation(x_m);
    }
    std::this_thread::sleep_for(period + std::chrono::microseconds(7919 * (turn % 13)));  // at any time of the community's ticks
    x_m = -x_m;
    const auto since = Clock::now();
    navigation(x_m);
    std::thread rest([&] {  // navigation goes on meanwhile
      for (int i = 0; i < settled; i++) {
        std::this_thread::sleep_for(period);
        navigation(x_m);
      }
    });
    const double us = turned(x_m < 0, since);
    rest.join();
    std::fprintf(told, "%.1f\n", us);
    std::fflush(told);
  }
  return 0;
}
