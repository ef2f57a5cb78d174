#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "coach/correct/correction.h"

/// The range that a therapist allows a patient, and the alarm when it is left or about to be. It
/// needs no reference: it is watched whatever the learner does.
namespace secondskin::coach {

/// One movement's allowed angles, as anatomy.h reads them.
struct JointLimit {
  Joint joint{};
  Movement movement{};
  double minimum = 0.0;  ///< [rad]
  double maximum = 0.0;  ///< [rad]
};

/// What is not named is not limited.
struct SafeRange {
  std::vector<JointLimit> limits;

  /// Reads a file with a table [limits_deg.JOINT] for each joint and in it, for each limited
  /// movement, flexion|abduction|rotation = [least, most] in degrees.
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static SafeRange load(const std::filesystem::path& file);
};

/// How far ahead leaving is predicted: a person's reaction to a cue [s].
inline constexpr double kAlarmLookahead = 0.2;

/// Which joints are to turn back, and how.
struct SafeRangeAlarm {
  JointVectors target = zero_vectors();  ///< back inside; zero where all is well [rad]
  /// How far outside the joint is, or is about to be [rad]; 0 where all is well.
  std::array<double, kJointCount> excess{};
  bool any = false;
};

/// Begins outside the range, or if it is left by more than 2 degrees within the look-ahead at the
/// present velocity; ends a degree inside it. Value type; no allocation after construction.
class SafeRangeMonitor {
 public:
  explicit SafeRangeMonitor(SafeRange range) noexcept : range_(std::move(range)) {
    active_.resize(range_.limits.size());
  }

  /// @param pose      canonical; joints with confidence 0 are not judged and raise no alarm
  /// @param velocity  of each joint, in its own frame [rad/s]
  const SafeRangeAlarm& update(const Pose& pose, const JointVectors& velocity) noexcept;

 private:
  SafeRange range_;
  std::vector<bool> active_;  ///< by limit
  SafeRangeAlarm alarm_;
};

}  // namespace secondskin::coach
