#pragma once

#include <array>
#include <vector>

#include "coach/align/pose_features.h"

/// Do learner and expert go the same way? Compares how the joints moved about their own means along
/// an alignment, so a posture, a limb held otherwise or a smaller range of motion, which differ
/// from person to person, do not count against a learner. docs/alignment.md, section 4.
namespace secondskin::coach {

class Likeness {
 public:
  explicit Likeness(const Reference& reference);

  void clear() noexcept;

  /// Forgets all but a share of what was added.
  void fade(double keep) noexcept;

  /// @param position  where the learner is taken to be [frames of the reference]
  /// @param dt  for how long [s]
  void add(const LearnerFeatures& learner, double position, double dt) noexcept;

  double time() const noexcept { return time_; }  ///< of what was added and not forgotten [s]

  struct Value {
    double correlation = 0.0;  ///< -1 to 1, over all joints by their weights
    double learner = 0.0;      ///< RMS way of the learner's joints from their means [rad]
    double expert = 0.0;       ///< the expert's, over the same frames [rad]
    double least = 0.0;        ///< correlation of the limb that goes least with the expert's
  };
  Value value() const noexcept;

 private:
  using Way = std::array<float, 3>;
  struct Track {
    std::size_t joint;
    float weight;
    JointFeature mean;     // of the expert's orientation
    std::vector<Way> way;  // of the expert from there, by frame [rad]
  };
  struct Sums {
    double time = 0.0;
    std::array<double, 3> learner{}, expert{};
    double learner_square = 0.0, expert_square = 0.0, product = 0.0;
  };
  std::vector<Track> tracks_;
  std::vector<Sums> sums_;
  double time_ = 0.0;
};

}  // namespace secondskin::coach
