#include <signal.h>

#include <string>
#include <thread>

#include "clients/history/history_service.h"

// The history's service by itself: DOMAIN SUBJECT FILE. Ends with SIGTERM.
int main(int, char** argv) {
  using namespace secondskin;
  sigset_t end;
  sigemptyset(&end);
  sigaddset(&end, SIGTERM);
  pthread_sigmask(SIG_BLOCK, &end, nullptr);
  signal(SIGXFSZ, SIG_IGN);
  bus::Config config;
  config.domain = static_cast<std::uint32_t>(std::stoul(argv[1]));
  config.subject = argv[2];
  config.qos_file = argv[4];
  config.name = "history";
  bus::Participant participant(config);
  history::HistoryService service(participant, argv[3]);
  std::jthread run([&](std::stop_token stop) { service.run(stop); });
  int got = 0;
  sigwait(&end, &got);
}
