#pragma once

#include <string>
#include <vector>

#include "clients/history/records.h"

/// Sessions that were never held, for tests.
namespace secondskin::history {

inline constexpr std::int64_t kSecond = 1'000'000'000;
inline constexpr std::int64_t kHour = 3600 * kSecond;
inline constexpr std::int64_t kDay = 24 * kHour;
inline constexpr std::int64_t kMorning = 20'000 * kDay + 10 * kHour;  // 2024-10-04, 10:00 UTC

/// Repetitions of four seconds, one every five, with these totals.
inline Block block_of(std::uint32_t index, const std::string& schedule, std::int64_t start_ns,
                      const std::vector<double>& totals, double tempo = 1.0) {
  Block block{.index = index,
              .name = schedule + " " + std::to_string(index),
              .start_ns = start_ns,
              .tempo = tempo,
              .schedule = schedule,
              .planned = 0,
              .tolerance_scale = 1.0,
              .max_cues = 2,
              .repetitions = {}};
  for (std::size_t i = 0; i < totals.size(); ++i) {
    const std::int64_t begin = start_ns + static_cast<std::int64_t>(i) * 5 * kSecond + kSecond;
    Repetition repetition{.number = static_cast<std::uint32_t>(i + 1),
                          .stamp_ns = begin + 4 * kSecond,
                          .start_ns = begin,
                          .end_ns = begin + 4 * kSecond,
                          .total = totals[i],
                          .cues = schedule == kNoCues ? 0u : 7u,
                          .cued = schedule != kNoCues,
                          .joints = {}};
    repetition.joints.push_back(
        {"left_knee", true, 0.3 / double(i + 1), 0.5, 0.75, 0.02, -1.6, 1.4, 1.5});
    repetition.joints.push_back({"right_hip", false, 0, 0, 0, {}, {}, 0, 0});
    block.repetitions.push_back(std::move(repetition));
  }
  return block;
}

inline Session session_of(std::int64_t id, std::int64_t start_ns, std::vector<Block> blocks) {
  Session session;
  session.id = id;
  session.learner = "L-TEST34";
  session.subject = "learner";
  session.start_ns = start_ns;
  session.end_ns = start_ns + kHour;
  session.reference = {"squat", 7, "Deep squat, down and up.", 2.2};
  session.plan = "retention";
  session.source = "replay:somebody.bvh";
  session.body_map = "full_body";
  session.blocks = std::move(blocks);
  for (const Block& block : session.blocks) session.repetitions += block.repetitions.size();
  session.exposure.push_back({3, "left_thigh", 10.0, 12.5, 0.25, 1.5});
  return session;
}

}  // namespace secondskin::history
