#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

/// Which values a filter takes and how much it trusts them: a chi-square gate, and for each
/// detector and projector a doubt that grows with values that do not fit. One thread.
///
/// Values at the edge of a detector's view lose bits for many cycles: some are far off, and gated,
/// others by a count or two. So the doubt is the recent mean of the normalised innovations squared
/// (which is 1 where all is well), and a doubted value's variance is taken so much larger. Where a
/// projector has just come into view, that is at this edge, there is some doubt to begin with.
namespace secondskin::server {

struct ValueNoise {
  double count_sigma = 0.5;  ///< noise of a value before it is rounded [counts]
  double model_sigma = 0.2;  ///< what calibration and masks leave [counts]
  double gate = 3.3;         ///< a value further off is not used [standard deviations]
};

/// What became of values.
struct ValueCounts {
  std::uint64_t used = 0;
  std::uint64_t gated = 0;  ///< not what the other values say
};

/// How one projector's values fit to the others'. One that went dark has no more of them, one that
/// was moved has them gated or, moved a little, off by a mean.
struct ProjectorCounts : ValueCounts {
  double innovation_sum = 0.0;      ///< of the values that were used [counts]
  double innovation_squares = 0.0;  ///< [counts^2]
};

class ValueGate {
 public:
  /// @throws std::invalid_argument naming the option that is out of range
  ValueGate(std::size_t detectors, std::size_t projectors, const ValueNoise& noise);

  /// The variance of a value that is not doubted: rounding, noise, model [counts^2].
  double variance() const noexcept { return variance_; }

  /// There is no value.
  void missing(std::size_t detector, std::size_t projector) noexcept {
    doubts_[detector * projectors_.size() + projector] = kFirstDoubt;
  }
  /// There is a value that is left out for another reason.
  void leave_out(std::size_t detector, std::size_t projector) noexcept {
    ++counts_[detector].gated;
    ++projectors_[projector].gated;
  }
  /// Judges a value by its innovation nu and nu's normalised square, taken with variance().
  /// @return the variance to use it with; empty when it is not to be used
  [[nodiscard]] std::optional<double> admit(std::size_t detector, std::size_t projector, double nu,
                                            double normalised_square) noexcept;

  std::span<const ValueCounts> detector_counts() const noexcept { return counts_; }
  std::span<const ProjectorCounts> projector_fits() const noexcept { return projectors_; }

 private:
  static constexpr float kFirstDoubt = 3.0F;

  double gate_, variance_;
  std::vector<float> doubts_;  ///< detector-major
  std::vector<ValueCounts> counts_;
  std::vector<ProjectorCounts> projectors_;
};

/// Tells a track that lives on the few values that happen to fit from one that is right: by the
/// recent share of gated values, and by cycles in a row in which most were gated. Such a cycle does
/// not count for the share: one alone is a torn set.
class Strain {
 public:
  void add(int used, int gated) noexcept {
    if (gated > used) {
      ++row_;
    } else if (used > 0) {
      row_ = 0;
      share_ += kRate * (static_cast<double>(gated) / (used + gated) - share_);
    }
  }
  /// Not to be given out.
  bool suspect() const noexcept { return row_ > 0 || share_ > 0.25; }
  /// To be given up.
  bool broken() const noexcept { return row_ >= 3 || share_ > 0.3; }

 private:
  static constexpr double kRate = 0.2;
  double share_ = 0.0;
  int row_ = 0;
};

}  // namespace secondskin::server
