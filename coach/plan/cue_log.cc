#include "coach/plan/cue_log.h"

#include <algorithm>

namespace secondskin::coach {

void CueLog::take(std::uint32_t repetition, double share, std::span<const Cue> cues,
                  const CorrectionResult& correction, const JointVectors& error,
                  const std::array<double, kJointCount>& tolerance) {
  std::array<bool, kJointCount> on{};
  for (const Cue& cue : cues) {
    if (cue.alarm) continue;
    const std::size_t j = index(cue.joint);
    on[j] = true;
    Open& open = open_[j];
    // Another repetition, or back in this one, is another cue.
    if (open.on && (given_[open.at].repetition != repetition || share < given_[open.at].from)) {
      open.on = false;
    }
    if (!open.on) {
      open = {true, given_.size()};
      given_.push_back({repetition, share, share, cue.joint, Eigen::Vector3d::Zero()});
      sums_.emplace_back();
    }
    GivenCue& given = given_[open.at];
    given.to = std::max(given.to, share);
    Sums& sums = sums_[open.at];
    if (!correction.target[j].isZero()) sums.direction += correction.target[j].normalized();
    sums.excess += std::max(0.0, error[j].norm() - tolerance[j]);
    ++sums.frames;
  }
  for (std::size_t j = 0; j < kJointCount; ++j) {
    if (!on[j]) open_[j].on = false;
  }
}

std::vector<GivenCue> CueLog::cues() const {
  std::vector<GivenCue> cues;
  for (std::size_t i = 0; i < given_.size(); ++i) {
    const Sums& sums = sums_[i];
    if (sums.direction.isZero()) continue;
    cues.push_back(given_[i]);
    cues.back().ask =
        sums.direction.normalized() * (sums.excess / static_cast<double>(sums.frames));
  }
  return cues;
}

}  // namespace secondskin::coach
