#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "server/wearable/estimate/body_filter.h"
#include "server/wearable/start/functional_alignment.h"
#include "server/wearable/start/rest_finder.h"
#include "server/wearable/start/rest_fit.h"
#include "server/wearable/start/wearer.h"

/// The start of a wearable capture (section 5.4): still phase, gravity, distances, boards swapped
/// left and right, and, where boards sit as they may, a few movements. Gives what the filter needs.
namespace secondskin::server {

struct StartSettings {
  Wearer wearer;
  /// The wearer's body where it has been measured otherwise, e.g. with markers; instead of
  /// `wearer`.
  std::optional<Skeleton> body;
  Pose pose{kJointCount};  ///< that the wearer is asked to hold; canonical rest unless said
  /// Rotation of each board on its segment, q_BS; empty entries are found. An empty vector: all as
  /// the garment's file says.
  std::vector<std::optional<Eigen::Quaterniond>> mountings;
  /// Seconds of movement after the rest for functional alignment; 0: none. Needed where mountings
  /// are not known.
  double movement = 0.0;
  bool refine_bones = true;  ///< by the distances at rest
  RestSettings rest;
  RestFitSettings fit;
};

/// What the start found, and how well it fits.
struct StartResult {
  Skeleton skeleton;
  Pose pose;                  ///< at stamp_ns, feet on z = 0
  std::int64_t stamp_ns = 0;  ///< the rest's end
  std::vector<Eigen::Isometry3d> X_BS;
  std::vector<BoardBias> biases;
  std::vector<std::optional<Eigen::Vector3d>> fields_S;  ///< magnetic field at rest, per board [T]
  std::vector<BoardHeading> headings;                    ///< empty without movement
  std::vector<Swap> swapped;
  /// Which board's readings arrive as which: readings of board b are those of channel[b]. The
  /// identity unless boards are swapped.
  std::vector<std::size_t> channel;
  RestFit fit;
  double rest = 0.0;                  ///< how long the wearer stood still [s]
  std::vector<std::string> warnings;  ///< for people: what is odd, by board name
};

/// `body`, else what follows from `wearer`.
Skeleton body_of(const StartSettings& settings);

/// Feet of a pose on z = 0.
void stand_on_floor(const Skeleton& canonical, Pose& pose);

/// The whole start from a rest and, where there is one, the movement that followed. A swap that
/// sound or gravity shows is put right in `channel`; one that only the gyroscopes show is named,
/// and left to the wearer.
StartResult initialise(const Garment& garment, const StartSettings& settings, const Rest& rest,
                       const Movement* movement = nullptr);

/// Collects a stream's beginning until initialise() can be called. One thread.
class Starter {
 public:
  enum class Stage { kWaitingForRest, kMoving, kDone };

  Starter(const Garment& garment, StartSettings settings);

  Stage add(const Measurement& measurement);
  Stage stage() const noexcept { return stage_; }
  /// At the end of a file: with what there is. @throws std::runtime_error when the wearer never
  /// stood still, saying what is expected
  StartResult finish() const;

 private:
  Garment garment_;
  StartSettings settings_;
  RestFinder finder_;
  std::optional<Rest> rest_;
  std::optional<Movement> movement_;
  Stage stage_ = Stage::kWaitingForRest;
};

}  // namespace secondskin::server
