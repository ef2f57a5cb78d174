#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "coach/correct/correction.h"
#include "coach/tactile/body_map.h"

/// From correction to vibration. A function of (correction, map, state, time): no clock, no
/// threads. docs/tactile.md has the rules.
namespace secondskin::coach {

struct TactileOptions {
  std::uint32_t max_cues = 2;  ///< at most so many joints cued at once
  double min_hold = 0.2;       ///< a cue lasts at least so long, to be felt [s]
};

/// One cue that is being given.
struct Cue {
  Joint joint{};
  Movement movement{};    ///< the movement that is asked for
  bool positive = true;   ///< towards flexion, abduction or internal rotation, or away from it
  std::uint8_t slot = 0;  ///< the board's slot that says it
  std::uint8_t intensity = 0;
};

class TactileMapper {
 public:
  TactileMapper(BodyMap map, const TactileOptions& options = {});

  /// @param correction  the solver's targets in use; every joint with target zero is not cued
  /// @param error       the present joint errors
  /// @param tolerance   dead band of each joint [rad]: inside it a joint is never cued
  /// @param enabled     false (paused, lost, stopped): everything off at once
  /// @returns the whole board. No allocation.
  [[nodiscard]] wire::BoardState update(std::int64_t stamp_ns, const CorrectionResult& correction,
                                        const JointVectors& error,
                                        const std::array<double, kJointCount>& tolerance,
                                        bool enabled) noexcept;

  std::span<const Cue> cues() const noexcept { return {cues_.data(), cue_count_}; }
  /// Onsets so far: of all, and by joint. The same joint at another place is another cue.
  std::uint64_t cues_given() const noexcept { return cues_given_; }
  const std::array<std::uint64_t, kJointCount>& cues_by_joint() const noexcept {
    return cues_by_joint_;
  }

 private:
  /// Where a joint's cues are felt, by the rest pose's geometry.
  struct Site {
    bool worn = false;  ///< whether any tactor serves the joint
    Joint segment{};
    Eigen::Vector3d lever;              ///< from the joint to where the movement is shown
    bool along_axis = false;            ///< the joint's own long axis is the worn segment's
    std::optional<std::size_t> ring;    ///< for saltation
    bool ring_counterclockwise = true;  ///< seen from above in the rest pose
  };
  /// What a cue would say: one tactor, or a ring in one direction.
  struct Place {
    bool rotation = false;
    bool reverse = false;    ///< of the ring
    std::size_t tactor = 0;  ///< index in the map
    double fit = 0.0;        ///< 1: the tactor sits exactly on the side
  };
  struct Given {
    std::int64_t onset_ns = 0;
    Place place;
    int step = 1;  ///< of the strength, from 1
  };

  std::optional<Place> place(std::size_t joint, const Eigen::Vector3d& target,
                             const Place* present) const noexcept;
  void write(std::size_t cue, wire::BoardState& board) noexcept;
  void remove(std::size_t cue) noexcept;

  BodyMap map_;
  TactileOptions options_;
  std::array<Site, kJointCount> sites_{};
  std::array<Cue, kJointCount> cues_{};
  std::array<Given, kJointCount> given_{};
  std::size_t cue_count_ = 0;
  std::uint64_t cues_given_ = 0;
  std::array<std::uint64_t, kJointCount> cues_by_joint_{};
};

}  // namespace secondskin::coach
