#pragma once

#include <array>
#include <vector>

#include "coach/align/aligner.h"
#include "coach/align/pose_features.h"

/// Online time warping as a Bayes filter: the probability of each reference frame in a window and
/// of each tempo, moved on by the tempo and weighted by how well the frame fits the learner's pose
/// and velocity. docs/alignment.md, section 2.
namespace secondskin::coach {

class PositionFilter {
 public:
  static constexpr std::size_t kTempi =
      16;  ///< row k: tempo k * tempo_step(); row 0: standing still

  static constexpr double kLongestStep = 0.5;  ///< [s]

  struct Estimate {
    double position = 0.0;  ///< [frames]
    double tempo = 0.0;
    double concentration = 0.0;  ///< probability within 0.15 s of the position
  };

  PositionFilter(std::size_t frames, double rate_hz, const AlignerOptions& options);

  /// The window's frames [begin, begin + width).
  std::size_t begin() const noexcept { return begin_; }
  std::size_t width() const noexcept { return width_; }

  /// Forgets everything: standing still, or about to move, at one of the first `zone` frames.
  void start(std::size_t zone) noexcept;

  /// Mixes the prior of start() in. @param share  of the new probability, 0 to 1
  void mix_start(std::size_t zone, double share) noexcept;

  /// Forgets everything but: about this frame, at any tempo. Moves the window there.
  void relocate(double position) noexcept;

  /// Moves the probability on by `dt` seconds, at most kLongestStep.
  /// @param jump_rate  of being anywhere else in the window [1/s]
  void predict(double dt, double jump_rate) noexcept;

  /// Weights by the learner's pose.
  /// @param costs  of the window's frames
  /// @param pose_variance  how far the learner is from the expert at the best of times [rad^2]
  /// @param information  how much this pose counts, 1 for a new one at the reference's rate
  void correct(const FrameCosts& costs, const LearnerFeatures& learner, double pose_variance,
               double information) noexcept;

  Estimate estimate() const noexcept { return estimate_; }

  /// Moves the window when the estimate has come near its edge.
  void follow() noexcept;

 private:
  float* row(std::size_t k) noexcept { return probability_.data() + k * width_; }
  void move_window(std::size_t begin) noexcept;
  void update_estimate(float total) noexcept;

  static constexpr std::ptrdiff_t kMargin = 8;  // frames

  std::size_t frames_, width_, padding_, begin_ = 0;
  double rate_hz_;
  float tempo_step_;
  std::size_t slowest_row_;                   // of those that a learner sets off at
  std::vector<float> probability_, next_;     // [tempo][frame of the window]
  std::vector<float> mixed_;                  // scratch: one row between zeros
  std::vector<float> cross_, speed_;          // scratch: the velocity costs with margins
  std::vector<float> likelihood_, marginal_;  // scratch, by frame of the window
  Estimate estimate_;
};

}  // namespace secondskin::coach
