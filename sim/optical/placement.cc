#include "sim/optical/placement.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "sim/optical/suit_scene.h"

namespace secondskin::sim {
namespace {

using Matrix6d = Eigen::Matrix<double, 6, 6>;

constexpr std::size_t kPlanesForAPoint = 4;  // 2.2.1

constexpr Joint kMeasured[] = {Joint::kPelvis,        Joint::kSpineUpper, Joint::kHead,
                               Joint::kLeftShoulder,  Joint::kLeftElbow,  Joint::kLeftWrist,
                               Joint::kRightShoulder, Joint::kRightElbow, Joint::kRightWrist,
                               Joint::kLeftHip,       Joint::kLeftKnee,   Joint::kLeftAnkle,
                               Joint::kRightHip,      Joint::kRightKnee,  Joint::kRightAnkle};

// What one place sees at one instant.
struct Sight {
  std::size_t planes = 0;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();  // A^T A, in W [counts^2/m^2]
};

// Looks at a scene's detectors through all projectors at one instant after the other.
class Observer {
 public:
  Observer(SuitScene& scene, std::span<const VirtualProjector> projectors,
           const OpticalNoise& noise)
      : scene_(scene),
        projectors_(projectors),
        clear_view_(std::cos(std::max(0.0, noise.view - noise.grazing))),
        states_(scene.detectors()) {
    for (const VirtualProjector& projector : projectors) P_.push_back(projector.matrix());
  }

  void look(double time) { scene_.at(time, states_); }

  const DetectorState& state(std::size_t detector) const { return states_[detector]; }

  Sight sight(std::size_t detector) const {
    const DetectorState& state = states_[detector];
    Sight sight;
    for (std::size_t j = 0; j < projectors_.size(); ++j) {
      const VirtualProjector& projector = projectors_[j];
      if (projector.dark || !projector.coordinate(state.p_W)) continue;
      const Eigen::Vector3d p_WJ = projector.X_WJ.translation();
      const Eigen::Vector3d to_projector = (p_WJ - state.p_W).normalized();
      if (state.n_W.dot(to_projector) < clear_view_ || scene_.hidden(detector, p_WJ)) continue;
      ++sight.planes;
      const Eigen::Vector2d hv = P_[j].leftCols<3>() * state.p_W + P_[j].col(3);
      const Eigen::RowVector3d gradient =
          (P_[j].row(0).head<3>() - (hv[0] / hv[1]) * P_[j].row(1).head<3>()) / hv[1];
      sight.information += gradient.transpose() * gradient;
    }
    return sight;
  }

 private:
  SuitScene& scene_;
  std::span<const VirtualProjector> projectors_;
  double clear_view_;
  std::vector<DetectorState> states_;
  std::vector<Eigen::Matrix<double, 2, 4>> P_;
};

// A value's error is the edge's noise and its rounding.
double value_sigma(const OpticalNoise& noise) {
  return std::sqrt(noise.count_sigma * noise.count_sigma + 1.0 / 12.0);
}

// What a point of a segment tells of the segment: its position and its rotation about p_WB.
Matrix6d segment_information(const Sight& sight, const Eigen::Vector3d& arm) {
  Eigen::Matrix<double, 3, 6> J;
  Eigen::Matrix3d cross;
  cross << 0.0, -arm.z(), arm.y(), arm.z(), 0.0, -arm.x(), -arm.y(), arm.x(), 0.0;
  J << Eigen::Matrix3d::Identity(), -cross;
  return J.transpose() * sight.information * J;
}

double log_det(const Matrix6d& information) {
  return 2.0 * information.llt().matrixL().toDenseMatrix().diagonal().array().log().sum();
}

double median(std::vector<double>& values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct Survey {
  std::vector<PlacementScore> scores;
  std::vector<std::vector<Matrix6d>> information;  // by detector, then instant; if asked for
};

Survey survey(SuitScene& scene, const Suit& suit, double duration,
              std::span<const VirtualProjector> projectors, const OpticalNoise& noise, double step,
              bool with_information) {
  Observer observer(scene, projectors, noise);
  const double sigma = value_sigma(noise);
  const auto instants = static_cast<std::size_t>(duration / step) + 1;
  const std::size_t count = suit.detectors.size();
  Survey result;
  std::vector<std::vector<double>> errors(count);
  for (const SuitDetector& detector : suit.detectors) result.scores.push_back({detector, 0, 0, 0});
  result.information.resize(with_information ? count : 0);
  for (std::size_t k = 0; k < instants; ++k) {
    observer.look(static_cast<double>(k) * step);
    for (std::size_t i = 0; i < count; ++i) {
      const Sight sight = observer.sight(i);
      PlacementScore& score = result.scores[i];
      score.planes += static_cast<double>(sight.planes);
      const bool is_point = sight.planes >= kPlanesForAPoint;
      if (is_point) {
        score.visible += 1.0;
        errors[i].push_back(sigma * std::sqrt(sight.information.inverse().trace()));
      }
      if (with_information) {
        const Eigen::Vector3d& p_WB = scene.segments()[index(scene.segment(i))].translation();
        result.information[i].push_back(
            is_point ? segment_information(sight, observer.state(i).p_W - p_WB)
                     : Matrix6d(Matrix6d::Zero()));
      }
    }
  }
  for (std::size_t i = 0; i < count; ++i) {
    result.scores[i].visible /= static_cast<double>(instants);
    result.scores[i].planes /= static_cast<double>(instants);
    result.scores[i].sigma = median(errors[i]);
  }
  return result;
}

}  // namespace

std::vector<PlacementScore> score_suit(const Motion& canonical, const Suit& suit,
                                       std::span<const VirtualProjector> projectors,
                                       const OpticalNoise& noise, const PlacementOptions& options) {
  SuitScene scene(canonical, suit);
  return survey(scene, suit, canonical.duration(), projectors, noise, options.step, false).scores;
}

std::vector<PlacementScore> sweep_places(const Motion& canonical, const PlacementGrid& grid,
                                         std::span<const VirtualProjector> projectors,
                                         const OpticalNoise& noise,
                                         const PlacementOptions& options) {
  const std::span<const Joint> segments =
      grid.segments.empty() ? std::span<const Joint>(kMeasured) : grid.segments;
  std::vector<PlacementScore> table;
  for (const Joint segment : segments) {
    Suit places;
    for (const double along : grid.along) {
      for (std::size_t i = 0; i < grid.angles; ++i) {
        const double angle =
            2.0 * std::numbers::pi * static_cast<double>(i) / static_cast<double>(grid.angles);
        places.detectors.push_back({{}, 0, 0, segment, along, angle});
      }
    }
    SuitScene scene(canonical, places);
    Survey found =
        survey(scene, places, canonical.duration(), projectors, noise, options.step, true);

    // Where nothing is measured yet, the segment is known to a metre and a radian: so the first
    // place counts for something, but for less than a second where it adds a direction.
    const std::size_t instants = found.information.empty() ? 0 : found.information[0].size();
    std::vector<Matrix6d> known(instants, Matrix6d::Identity());
    for (std::size_t rank = 1; rank <= options.best; ++rank) {
      std::optional<std::size_t> best;
      double best_worth = -std::numeric_limits<double>::infinity();
      for (std::size_t i = 0; i < found.scores.size(); ++i) {
        if (found.scores[i].rank > 0 || !(found.scores[i].visible > 0.0)) continue;
        bool crowded = false;
        for (std::size_t k = 0; k < found.scores.size(); ++k) {
          crowded |= found.scores[k].rank > 0 &&
                     (scene.place(i).p_BS - scene.place(k).p_BS).norm() < options.smallest_gap;
        }
        if (crowded) continue;
        double worth = 0.0;
        for (std::size_t k = 0; k < instants; ++k) {
          worth += log_det(known[k] + found.information[i][k]);
        }
        if (worth > best_worth) {
          best_worth = worth;
          best = i;
        }
      }
      if (!best) break;
      found.scores[*best].rank = rank;
      for (std::size_t k = 0; k < instants; ++k) known[k] += found.information[*best][k];
    }
    table.insert(table.end(), found.scores.begin(), found.scores.end());
  }
  return table;
}

}  // namespace secondskin::sim
