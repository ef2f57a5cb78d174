#include "server/mvn/mvn_source.h"

#include <spdlog/spdlog.h>

#include <chrono>

#include "bus/participant.h"

namespace secondskin::server {

using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

namespace {

constexpr auto kSilenceAfter = 250ms;
constexpr std::int64_t kStale_ns = 250'000'000;
constexpr std::size_t kLongestDatagram = 65536;

}  // namespace

MvnSource::MvnSource(const wire::UdpPlace& at, const RetargetOptions& options)
    : receiver_(at), stream_(options), buffer_(kLongestDatagram) {}

Next MvnSource::next(StampedPose& pose) {
  const auto end = Clock::now() + kSilenceAfter;
  for (auto now = Clock::now(); now < end; now = Clock::now()) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(end - now);
    const auto arrival = receiver_.receive(buffer_, left);
    if (!arrival) continue;
    // What queued up while nobody asked is no learner's movement of now; it counts as lost.
    if (bus::now_ns() - arrival->stamp_ns > kStale_ns) continue;
    const bool whole = stream_.add({buffer_.data(), arrival->length}, arrival->stamp_ns, pose);
    if (stream_.counts().other_avatars > 0 && !said_others_) {
      said_others_ = true;
      spdlog::warn("{}: several avatars; only avatar {}, the first one heard, is followed",
                   place().text(), *stream_.avatar());
    }
    if (!whole) continue;
    if (stream_.counts().poses == 1) {
      spdlog::info("{}: MVN avatar {} at {:g} Hz", place().text(), *stream_.avatar(), rate_hz());
    }
    return Next::kPose;
  }
  return Next::kSilence;
}

}  // namespace secondskin::server
