#include "clients/authoring/cut.h"

#include <fmt/format.h>

#include <Eigen/Eigenvalues>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <stdexcept>

#include "coach/align/pose_features.h"
#include "coach/align/reference_measure.h"
#include "motion/anatomy.h"
#include "motion/rotation.h"

namespace secondskin::authoring {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kRate = 15.0;       // poses are compared at [Hz]
constexpr std::size_t kLag = 2;      // speeds are differences over twice so many frames
constexpr double kStillShare = 0.1;  // of the fast movements' speed is rest
constexpr double kMostStill = 0.4;   // of the same, however slow the movement is
constexpr double kFastestStill = 20.0 * kDegree;
constexpr double kMargin = 0.2;              // of rest is kept [s]
constexpr double kQuietest = 2.0 * kDegree;  // poses that differ by less are no movement
constexpr std::size_t kMostAnchors = 40;
constexpr double kNear = 0.4;            // of the typical distance: at the posture
constexpr double kAway = 0.7;            // of the same: left it; a take's ends may be so far
constexpr double kShortest = 0.4;        // a stroke lasts at least [s]
constexpr double kAlike = 0.6;           // of the typical distance: the same movement
constexpr double kTempo = 2.5;           // of one stroke to another, at most
constexpr std::size_t kMostStrokes = 4;  // in a repetition
constexpr double kStrokePenalty = 0.15;  // fewer strokes are the simpler explanation
constexpr double kEndBonus = 0.25;       // of a posture that the movement began or ended in
constexpr double kCovered = 0.4;         // of the movement are repetitions, or it is one

// Frames [begin, end] of the resampled motion.
struct Frames {
  std::size_t begin, end;
  std::size_t length() const { return end - begin; }
};

// All poses of a motion against each other, in what moves in it.
class Likeness {
 public:
  explicit Likeness(const Motion& motion) : n_(motion.poses.size()), square_(n_ * n_) {
    coach::Reference reference{.name = {},
                               .description = {},
                               .origin = {},
                               .licence = {},
                               .motion = motion,
                               .weight = weights(motion)};
    const coach::ReferenceFeatures features(reference, 1);
    for (std::size_t a = 0; a < n_; ++a) {
      for (std::size_t b = 0; b < a; ++b) {
        square_[a * n_ + b] = square_[b * n_ + a] = std::max(0.0F, features.distance_square(a, b));
      }
    }
  }

  std::size_t size() const { return n_; }
  double square(std::size_t a, std::size_t b) const { return square_[a * n_ + b]; }
  double distance(std::size_t a, std::size_t b) const { return std::sqrt(square(a, b)); }

  // RMS over all pairs of the frames.
  double typical(Frames frames) const {
    double sum = 0.0;
    for (std::size_t a = frames.begin; a <= frames.end; ++a) {
      for (std::size_t b = frames.begin; b <= frames.end; ++b) sum += square(a, b);
    }
    return std::sqrt(sum) / static_cast<double>(frames.length() + 1);
  }

  // RMS distance along the best warping path, ends onto ends (dynamic time warping).
  double warped(Frames a, Frames b) const {
    const std::size_t columns = b.length() + 1;
    std::vector<double> cost(columns), above(columns), steps(columns), steps_above(columns);
    for (std::size_t i = 0; i <= a.length(); ++i) {
      cost.swap(above);
      steps.swap(steps_above);
      for (std::size_t k = 0; k < columns; ++k) {
        const double d = square(a.begin + i, b.begin + k);
        double best = i + k == 0 ? 0.0 : std::numeric_limits<double>::infinity();
        double length = 0.0;
        const auto from = [&](double total, double count) {
          if (total < best) {
            best = total;
            length = count;
          }
        };
        if (i > 0 && k > 0) from(above[k - 1], steps_above[k - 1]);
        if (i > 0) from(above[k], steps_above[k]);
        if (k > 0) from(cost[k - 1], steps[k - 1]);
        cost[k] = best + d;
        steps[k] = length + 1.0;
      }
    }
    return std::sqrt(cost.back() / steps.back());
  }

 private:
  // A joint counts by how much it moves: RMS distance from its mean orientation.
  static std::array<double, kJointCount> weights(const Motion& motion) {
    std::array<double, kJointCount> moved{};
    for (std::size_t j = 0; j < kJointCount; ++j) {
      Eigen::Matrix4d sum = Eigen::Matrix4d::Zero();
      for (const Pose& pose : motion.poses) {
        if (pose.confidence[j] <= 0.0F) continue;
        const Eigen::Vector4d q = pose.q_PB[j].coeffs();
        sum += q * q.transpose();
      }
      // The mean orientation is the largest eigenvector (Markley et al. 2007, J. Guid. 30:1193).
      const Eigen::SelfAdjointEigenSolver<Eigen::Matrix4d> solver(sum);
      const Eigen::Quaterniond mean(Eigen::Vector4d(solver.eigenvectors().col(3)));
      double squares = 0.0, count = 0.0;
      for (const Pose& pose : motion.poses) {
        if (pose.confidence[j] <= 0.0F) continue;
        const double angle = j == index(Joint::kPelvis) ? tilt_between(mean, pose.q_PB[j])
                                                        : geodesic_distance(mean, pose.q_PB[j]);
        squares += angle * angle;
        count += 1.0;
      }
      if (count > 0.0) moved[j] = std::sqrt(squares / count);
    }
    for (const Joint joint :
         {Joint::kLeftWrist, Joint::kRightWrist, Joint::kLeftToes, Joint::kRightToes}) {
      moved[index(joint)] *= 0.5;  // measured worst
    }
    const double most = *std::max_element(moved.begin(), moved.end());
    for (double& each : moved) each = most > 0.0 ? std::max(each / most, 0.01) : 1.0;
    return moved;
  }

  static double tilt_between(const Eigen::Quaterniond& a, const Eigen::Quaterniond& b) {
    const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
    return std::acos(std::clamp((a.conjugate() * up).dot(b.conjugate() * up), -1.0, 1.0));
  }

  std::size_t n_;
  std::vector<float> square_;
};

std::vector<double> speeds(const Likeness& poses) {
  const std::size_t n = poses.size();
  std::vector<double> v(n, 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    const std::size_t a = i > kLag ? i - kLag : 0, b = std::min(i + kLag, n - 1);
    if (b > a) v[i] = poses.distance(a, b) * kRate / static_cast<double>(b - a);
  }
  return v;
}

// Slower is rest.
double resting_speed(std::vector<double> v) {
  const auto ninth = v.begin() + static_cast<std::ptrdiff_t>(v.size() * 9 / 10);
  std::nth_element(v.begin(), ninth, v.end());
  return std::clamp(kStillShare * *ninth, std::min(coach::kStillSpeed, kMostStill * *ninth),
                    kFastestStill);
}

// A body in a posture, from begin to end, nearest to it at `at`.
struct Visit {
  std::size_t begin, end, at;
};

// One way of cutting.
struct Solution {
  double score = 0.0;
  double difference = 0.0;
  std::vector<Frames> repetitions;
};

class Cutter {
 public:
  explicit Cutter(const Motion& at_rate)
      : poses_(at_rate), v_(speeds(poses_)), still_(resting_speed(v_)) {
    const std::size_t last = poses_.size() - 1;
    const auto moves = [this](double v) { return v > still_; };
    const auto first = std::find_if(v_.begin(), v_.end(), moves);
    if (first == v_.end()) {
      moving_ = {0, last};
      return;
    }
    const auto end = std::find_if(v_.rbegin(), v_.rend(), moves);
    const auto margin = static_cast<std::size_t>(std::lround(kMargin * kRate));
    const auto begin = static_cast<std::size_t>(first - v_.begin());
    moving_ = {begin - std::min(begin, margin),
               std::min(last, last - static_cast<std::size_t>(end - v_.rbegin()) + margin)};
    typical_ = poses_.typical(moving_);
  }

  Frames moving() const { return moving_; }
  double typical() const { return typical_; }

  Solution solve() const {
    Solution best;
    if (typical_ < kQuietest) return best;
    for (const std::size_t anchor : anchors()) {
      Solution solution = around(anchor);
      for (const std::size_t end : {moving_.begin, moving_.end}) {
        if (poses_.distance(anchor, end) < kNear * typical_) solution.score *= 1.0 + kEndBonus;
      }
      if (solution.score > best.score) best = std::move(solution);
    }
    double covered = 0.0;
    for (const Frames& each : best.repetitions) covered += static_cast<double>(each.length());
    if (covered < kCovered * static_cast<double>(moving_.length())) best.repetitions.clear();
    return best;
  }

 private:
  // Postures in which the body is slow for a moment: a movement begins in one of them.
  std::vector<std::size_t> anchors() const {
    constexpr std::size_t kAround = 4;
    std::vector<std::size_t> found{moving_.begin, moving_.end};
    for (std::size_t i = moving_.begin + 1; i < moving_.end; ++i) {
      const auto a = v_.begin() + static_cast<std::ptrdiff_t>(i > kAround ? i - kAround : 0);
      const auto b = v_.begin() + static_cast<std::ptrdiff_t>(std::min(i + kAround + 1, v_.size()));
      if (v_[i] <= *std::min_element(a, b)) found.push_back(i);
    }
    std::stable_sort(found.begin() + 2, found.end(),
                     [this](std::size_t a, std::size_t b) { return v_[a] < v_[b]; });
    if (found.size() > kMostAnchors) found.resize(kMostAnchors);
    return found;
  }

  std::vector<Visit> visits(std::size_t anchor) const {
    std::vector<Visit> all;
    bool inside = false;
    for (std::size_t i = moving_.begin; i <= moving_.end; ++i) {
      const double d = poses_.distance(anchor, i) / typical_;
      const bool end = i == moving_.begin || i == moving_.end;
      if (d < (end ? kAway : kNear)) {
        if (!inside) all.push_back({i, i, i});
        inside = true;
        Visit& visit = all.back();
        visit.end = i;
        if (d < poses_.distance(anchor, visit.at) / typical_) visit.at = i;
      } else if (d > kAway) {
        inside = false;
      }
    }
    return all;
  }

  // From when the body leaves a posture to when it is back in it, with a little of the rest.
  std::vector<Frames> strokes(const std::vector<Visit>& visits) const {
    std::vector<Frames> all;
    for (std::size_t k = 0; k + 1 < visits.size(); ++k) {
      const Frames stroke{leaves(visits[k]), arrives(visits[k + 1])};
      if (static_cast<double>(stroke.length()) >= kShortest * kRate) all.push_back(stroke);
    }
    return all;
  }

  // Of the rest in the posture, what comes before its middle belongs to the stroke before.
  std::size_t leaves(const Visit& visit) const {
    for (std::size_t i = visit.end + 1; i-- > visit.at;) {
      if (v_[i] < still_) return i - std::min(i - visit.at, kRestKept);
    }
    return visit.at;
  }

  std::size_t arrives(const Visit& visit) const {
    for (std::size_t i = visit.begin; i <= visit.at; ++i) {
      if (v_[i] < still_) return std::min(visit.at, i + kRestKept);
    }
    return visit.at;
  }

  // The best run of alike groups of strokes that begin and end at the anchor.
  Solution around(std::size_t anchor) const {
    const auto all = strokes(visits(anchor));
    const std::size_t n = all.size();
    std::vector<double> apart(n * n, 0.0);
    for (std::size_t a = 0; a < n; ++a) {
      for (std::size_t b = 0; b < a; ++b) {
        apart[a * n + b] = apart[b * n + a] = difference(all[a], all[b]);
      }
    }
    Solution best;
    for (std::size_t p = 1; p <= std::min(kMostStrokes, n / 2); ++p) {
      for (std::size_t first = 0; first + p <= n; ++first) {
        Solution solution = like(all, apart, first, p);
        solution.score *= 1.0 - kStrokePenalty * static_cast<double>(p - 1);
        if (solution.score > best.score) best = std::move(solution);
      }
    }
    return best;
  }

  // All groups of p strokes that are like the p ones from `first` on.
  Solution like(const std::vector<Frames>& all, const std::vector<double>& apart, std::size_t first,
                std::size_t p) const {
    const std::size_t n = all.size();
    Solution result;
    double sum = 0.0, frames = 0.0;
    for (std::size_t k = first % p; k + p <= n;) {
      double worst = 0.0;
      for (std::size_t s = 0; s < p; ++s) worst = std::max(worst, apart[(first + s) * n + k + s]);
      if (worst > kAlike) {
        ++k;
        continue;
      }
      const Frames group{all[k].begin, all[k + p - 1].end};
      frames += static_cast<double>(group.length());
      sum += worst;
      result.repetitions.push_back(group);
      k += p;
    }
    if (result.repetitions.size() < 2) return {};
    result.difference = sum / static_cast<double>(result.repetitions.size() - 1);
    result.score = frames * (1.0 - result.difference);
    return result;
  }

  double difference(Frames a, Frames b) const {
    const auto la = static_cast<double>(a.length()), lb = static_cast<double>(b.length());
    if (la > kTempo * lb || lb > kTempo * la) return 1.0;
    return poses_.warped(a, b) / typical_;
  }

  static constexpr std::size_t kRestKept = 2;  // frames

  Likeness poses_;
  std::vector<double> v_;
  double still_;
  Frames moving_{};
  double typical_ = 0.0;
};

}  // namespace

Cutting cut(const Motion& canonical) {
  if (!is_canonical(canonical.skeleton)) {
    throw std::invalid_argument("take: expected a motion on the canonical skeleton");
  }
  const double duration = canonical.duration();
  if (!(duration >= kShortestTake && duration <= kLongestTake)) {
    throw std::invalid_argument(fmt::format("take: lasts {:.2f} s, expected {} to {} s", duration,
                                            kShortestTake, kLongestTake));
  }
  const Cutter cutter(resample(canonical, kRate));
  const auto seconds = [&](Frames frames) {
    return Span{static_cast<double>(frames.begin) / kRate,
                std::min(duration, static_cast<double>(frames.end) / kRate)};
  };
  Cutting result;
  result.moving = seconds(cutter.moving());
  const Solution solution = cutter.solve();
  for (const Frames& each : solution.repetitions) result.repetitions.push_back(seconds(each));
  if (result.repetitions.empty()) {
    result.repetitions.push_back(result.moving);
  } else {
    result.difference = solution.difference;
  }
  return result;
}

}  // namespace secondskin::authoring
