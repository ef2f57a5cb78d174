#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "coach/correct/correction.h"
#include "coach/tactile/body_map.h"
#include "coach/tactile/exposure.h"
#include "coach/tactile/safe_range.h"

/// From correction to vibration. A function of (correction, map, state, time): no clock, no
/// threads. docs/tactile.md has the rules and their sources.
namespace secondskin::coach {

struct TactileOptions {
  std::uint32_t max_cues = 2;  ///< at most so many joints cued at once
  double min_hold = 0.2;   ///< a cue lasts at least so long, to be felt; a turn at least one round
                           ///< of its ring [s]
  double max_hold = 0.25;  ///< and no longer, unless it is scaled by duration or an alarm: [s]
  double pause = 0.55;     ///< then its segment is silent while the person reacts and moves [s]
  bool duration_scaled = false;    ///< swings: longer, not stronger, as the error grows
  double command_lifetime = 0.06;  ///< how long the board obeys a command that no other follows [s]
};

/// One cue that is being given.
struct Cue {
  Joint joint{};
  Movement movement{};         ///< the movement that is asked for
  bool positive = true;        ///< towards flexion, abduction or internal rotation, or away from it
  bool alarm = false;          ///< the joint left its safe range, or is about to
  std::uint8_t slot = 0;       ///< the board's slot that says it
  std::uint8_t intensity = 0;  ///< 0 in the pauses of a cue scaled by duration
  std::optional<std::uint8_t> second_slot;  ///< of a phantom
  std::uint8_t second_intensity = 0;
};

/// Amplitudes of two tactors that are felt as one of amplitude 1 between them, by the energy model:
/// sqrt(1 - beta) and sqrt(beta) (Israr & Poupyrev 2011, Tactile Brush, CHI).
/// @param beta  0 at the first, 1 at the second
std::array<double, 2> phantom_weights(double beta) noexcept;

class TactileMapper {
 public:
  /// @param exposure  what the skin bore before
  explicit TactileMapper(BodyMap map, const TactileOptions& options = {},
                         const ExposureState& exposure = {});

  /// @param correction  the solver's targets in use; every joint with target zero is not cued
  /// @param error       the present joint errors
  /// @param tolerance   dead band of each joint [rad]: no cue begins inside it
  /// @param enabled     false (paused, lost, stopped): no correction is cued, at once
  /// @param alarm       joints outside their safe range: cued first, enabled or not; null for none
  /// @returns the whole board. No allocation.
  [[nodiscard]] wire::BoardState update(std::int64_t stamp_ns, const CorrectionResult& correction,
                                        const JointVectors& error,
                                        const std::array<double, kJointCount>& tolerance,
                                        bool enabled,
                                        const SafeRangeAlarm* alarm = nullptr) noexcept;

  /// How well the map can say this target to this joint, all sites being rested: the cosine between
  /// the rotation that is asked and the one that the cue says; 0 if it says nothing.
  double tells(Joint joint, const Eigen::Vector3d& target) const noexcept;
  /// The joints that some tactor serves.
  JointSet served() const noexcept;

  std::span<const Cue> cues() const noexcept { return {cues_.data(), cue_count_}; }
  /// Onsets so far: of all, and by joint. The same joint at another place is another cue.
  std::uint64_t cues_given() const noexcept { return cues_given_; }
  const std::array<std::uint64_t, kJointCount>& cues_by_joint() const noexcept {
    return cues_by_joint_;
  }
  const ExposureState& exposure() const noexcept { return limiter_.state(); }

 private:
  /// One place on a segment that can be felt: a tactor, or a phantom between two.
  struct Spot {
    std::size_t first = 0;   ///< index in the map
    std::size_t second = 0;  ///< the same but for a phantom
    double beta = 0.0;       ///< of the phantom, 0 at the first
    double angle = 0.0;      ///< around the segment [rad]
    bool is_phantom() const noexcept { return first != second; }
  };
  /// Where a joint's cues are felt, by the rest pose's geometry.
  struct Site {
    bool worn = false;  ///< whether any tactor serves the joint
    Joint segment{};
    Eigen::Vector3d lever;              ///< from the joint to where the movement is shown
    bool along_axis = false;            ///< the joint's own long axis is the worn segment's
    std::optional<std::size_t> ring;    ///< for saltation
    bool ring_counterclockwise = true;  ///< seen from above in the rest pose
  };
  /// What a cue would say: one spot, or a ring in one direction.
  struct Place {
    bool rotation = false;
    bool reverse = false;  ///< of the ring
    std::size_t spot = 0;  ///< index in the segment's spots
    double fit = 0.0;      ///< 1: the spot lies exactly on the side
  };
  struct Given {
    std::int64_t onset_ns = 0;
    Place place;
    int step = 1;  ///< of the strength, from 1
  };

  /// @param rested_only  leave out what has to rest; of an alarm with its reserve of the dose
  std::optional<Place> place(std::size_t joint, const Eigen::Vector3d& target, const Place* present,
                             bool rested_only, bool alarm) const noexcept;
  bool rests(std::size_t joint, const Place& place, bool alarm) const noexcept;
  void write(std::size_t cue, std::int64_t stamp_ns, wire::BoardState& board) noexcept;
  void start_motors(double dt, wire::BoardState& board) noexcept;
  void remove(std::size_t cue, std::int64_t stamp_ns) noexcept;
  double least_hold(std::size_t cue) const noexcept;  ///< [s]

  BodyMap map_;
  TactileOptions options_;
  std::array<Site, kJointCount> sites_{};
  std::array<std::vector<Spot>, kJointCount> spots_;  ///< by segment
  ExposureLimiter limiter_;
  std::array<Cue, kJointCount> cues_{};
  std::array<Given, kJointCount> given_{};
  std::size_t cue_count_ = 0;
  std::array<std::int64_t, kJointCount> quiet_until_ns_{};  ///< by segment
  wire::BoardState last_board_{};
  std::int64_t last_stamp_ns_ = 0;
  std::array<double, wire::kTactorCount> motor_{};  ///< each motor's vibration by its model, 0 to 1
  std::uint64_t cues_given_ = 0;
  std::array<std::uint64_t, kJointCount> cues_by_joint_{};
};

}  // namespace secondskin::coach
