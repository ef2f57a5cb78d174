#include <cstdio>
#include <string>

#include "clients/history/history.h"
#include "tests/history/course.h"

// Books one session after another until it is killed, and prints each repetition once it is booked.
int main(int, char** argv) {
  using namespace secondskin::history;
  History history(argv[1]);
  for (std::int64_t day = std::stoll(argv[2]) * 1000;; ++day) {
    const std::int64_t start = kMorning + day * kHour;
    Session session = session_of(0, start, {block_of(0, "always", start, {40, 50, 60, 70, 80})});
    session.end_ns.reset();
    history.book(session, true);
    for (const Repetition& repetition : session.blocks[0].repetitions) {
      history.book(session.subject, repetition);
      std::printf("%lld\n", static_cast<long long>(repetition.stamp_ns));
      std::fflush(stdout);
    }
  }
}
