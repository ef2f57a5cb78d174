#include "sim/wearable/worn_garment.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "motion/rotation.h"

namespace secondskin::sim {
namespace {

constexpr double kLivelyRate = 30.0;    // of the control points [Hz]
constexpr double kLivelyTime = 0.2;     // sigma of their smoothing [s]
constexpr double kHalfLively = 0.5;     // mean joint rate at which tissue moves half of all [rad/s]
constexpr double kSlowestTissue = 0.2;  // [Hz]
constexpr double kSpeedOfSound = 343.0;  // for the width of shadows

// A trunk is wider than deep, but its capsules are round (body_shape.cc): half the depth over the
// radius, by the same survey. What sits in front of it must not look past a belly that is not
// there.
double depth_share(Joint segment) noexcept {
  switch (segment) {
    case Joint::kPelvis:
      return 2.0 * 0.1415 / (0.2067 + 0.1415);
    case Joint::kSpineLower:
      return 2.0 * 0.1332 / (0.1850 + 0.1332);
    case Joint::kSpineMiddle:
      return 2.0 * (0.1332 + 0.1481) / (0.1850 + 0.1332 + 0.1651 + 0.1481);
    case Joint::kSpineUpper:
      return 2.0 * 0.1481 / (0.1651 + 0.1481);
    default:
      return 1.0;
  }
}

Eigen::Vector3d normal_vector(std::mt19937_64& random, double rms) {
  std::normal_distribution<double> normal(0.0, rms / std::sqrt(3.0));
  const double x = normal(random), y = normal(random), z = normal(random);
  return {x, y, z};
}

Skeleton mismeasured(const Skeleton& truth, double bone, std::mt19937_64& random) {
  std::normal_distribution<double> normal(0.0, bone);
  std::vector<Segment> segments = truth.segments();
  std::vector<double> scale;
  for (Segment& segment : segments) {
    scale.push_back(1.0 + normal(random));
    segment.p_BE *= scale.back();
    segment.p_BC *= scale.back();
    if (segment.parent) segment.p_PB *= scale[*segment.parent];
  }
  return Skeleton(std::move(segments));
}

}  // namespace

WornErrors WornErrors::none() {
  WornErrors none;
  none.mounting_angle = none.mounting_place = none.source_place = none.bone = 0.0;
  none.tissue_place = none.tissue_angle = 0.0;
  none.gyro_noise = none.accel_noise = none.gyro_bias = none.gyro_bias_walk = 0.0;
  none.accel_bias = none.scale = none.distance_noise = 0.0;
  return none;
}

WornGarment::WornGarment(const Motion& canonical, const Garment& garment, const WornErrors& errors,
                         std::uint64_t seed, double rest, double blend)
    : garment_(garment),
      errors_(errors),
      motion_(canonical, rest, blend),
      rest_(rest),
      assumed_(canonical.skeleton) {
  std::mt19937_64 random(seed);
  assumed_ = mismeasured(skeleton(), errors.bone, random);
  const auto wobble = [&] {
    std::uniform_real_distribution<double> hz(kSlowestTissue,
                                              std::max(kSlowestTissue, errors.tissue_hz));
    std::uniform_real_distribution<double> turn(0.0, 2.0 * std::numbers::pi);
    Wobble w;
    for (Eigen::Index i = 0; i < w.omega.size(); ++i) {
      w.omega(i) = 2.0 * std::numbers::pi * hz(random);
      w.phase(i) = turn(random);
    }
    return w;
  };
  for (const SensorBoard& board : garment_.boards) {
    Eigen::Isometry3d X_BS = board_place(skeleton(), board);
    X_BS.translation() += normal_vector(random, errors.mounting_place);
    X_BS.linear() =
        X_BS.linear() *
        quaternion_from(normal_vector(random, errors.mounting_angle)).toRotationMatrix();
    X_BS_.push_back(X_BS);
    board_place_.push_back(wobble());
    board_angle_.push_back(wobble());
  }
  for (const UltrasonicSource& source : garment_.sources) {
    Eigen::Isometry3d X_BU = source_place(skeleton(), source);
    const Eigen::Vector3d error = normal_vector(random, errors.source_place);
    if (source.segment) X_BU.translation() += error;
    X_BU_.push_back(X_BU);
    source_place_.push_back(wobble());
  }
  for (std::size_t i = 0; i < kJointCount; ++i) {
    capsules_[i] = segment_capsule(skeleton(), static_cast<Joint>(i));
    capsules_[i].radius *= depth_share(static_cast<Joint>(i));
  }
  find_liveliness();
  build_room();
}

void WornGarment::build_room() {
  constexpr double kReach = 2.5;  // from the pelvis to a wall [m]
  constexpr double kHard = 0.6;   // of the sound comes back
  double front = 0.0, right = 0.0;
  BodyMotion body;
  for (double time = 0.0; time <= duration(); time += 0.5) {
    motion_.at(time, body);
    front = std::max(front, body[0].X_WB.translation().x());
    right = std::min(right, body[0].X_WB.translation().y());
  }
  reflectors_.push_back({Eigen::Vector3d::UnitZ(), floor(), kHard});
  reflectors_.push_back({-Eigen::Vector3d::UnitX(), -(front + kReach), kHard});
  reflectors_.push_back({Eigen::Vector3d::UnitY(), right - kReach, kHard});
}

void WornGarment::find_liveliness() {
  const auto count = static_cast<std::ptrdiff_t>(std::ceil(duration() * kLivelyRate)) + 4;
  std::vector<double> rate;
  BodyMotion body;
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    motion_.at(std::clamp(static_cast<double>(k - 1) / kLivelyRate, 0.0, duration()), body);
    double sum = body[0].w.squaredNorm() + body[0].v.squaredNorm();
    for (std::size_t j = 1; j < kJointCount; ++j) {
      sum += (body[j].w - body[*skeleton()[j].parent].w).squaredNorm();
    }
    rate.push_back(std::sqrt(sum / static_cast<double>(kJointCount)));
  }
  const double sigma = kLivelyTime * kLivelyRate;
  const auto reach = static_cast<std::ptrdiff_t>(3.0 * sigma);
  double squares = 0.0, moving = 0.0;
  for (std::ptrdiff_t k = 0; k < count; ++k) {
    double sum = 0.0, total = 0.0;
    for (std::ptrdiff_t i = -reach; i <= reach; ++i) {
      const double z = static_cast<double>(i) / sigma, weight = std::exp(-0.5 * z * z);
      sum +=
          weight * rate[static_cast<std::size_t>(std::clamp(k + i, std::ptrdiff_t{0}, count - 1))];
      total += weight;
    }
    const double mean = sum / total;
    lively_.push_back(mean / (mean + kHalfLively));
    if (static_cast<double>(k - 1) / kLivelyRate > rest_) {
      squares += lively_.back() * lively_.back();
      moving += 1.0;
    }
  }
  constexpr double kStill = 1e-3;  // nothing moves, so no tissue does
  const double rms = moving > 0.0 ? std::sqrt(squares / moving) : 0.0;
  for (double& value : lively_) value = rms > kStill ? value / rms : 0.0;
}

WornGarment::Liveliness WornGarment::liveliness(double time) const noexcept {
  const double x = std::clamp(time, 0.0, duration()) * kLivelyRate;
  const double whole = std::floor(x);
  const SplineWeights weights(x - whole);
  const bool held = time < 0.0 || time > duration();
  Liveliness g{0.0, 0.0, 0.0};
  for (std::size_t k = 0; k < 4; ++k) {
    const double control = lively_[static_cast<std::size_t>(whole) + k];
    g.value += weights.value[k] * control;
    if (held) continue;
    g.first += kLivelyRate * weights.first[k] * control;
    g.second += kLivelyRate * kLivelyRate * weights.second[k] * control;
  }
  return g;
}

WornGarment::Moved WornGarment::moved(const Wobble& wobble, const Liveliness& g, double rms,
                                      double time) noexcept {
  if (rms == 0.0 || g.value == 0.0) {
    return {Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  }
  // Each of the tones has the same share of each axis' third of the variance.
  const double amplitude = rms * std::sqrt(2.0 / (3.0 * static_cast<double>(Wobble::kTones)));
  const auto angle = (wobble.omega * time + wobble.phase).eval();
  const auto sine = angle.sin().eval();
  const Eigen::Vector3d n = amplitude * sine.rowwise().sum();
  const Eigen::Vector3d n1 = amplitude * (wobble.omega * angle.cos()).rowwise().sum();
  const Eigen::Vector3d n2 = -amplitude * (wobble.omega.square() * sine).rowwise().sum();
  return {g.value * n, g.value * n1 + g.first * n,
          g.value * n2 + 2.0 * g.first * n1 + g.second * n};
}

void WornGarment::boards_at(double time, const BodyMotion& body,
                            std::span<BoardTruth> boards) const noexcept {
  const Liveliness g = liveliness(time);
  for (std::size_t i = 0; i < boards.size(); ++i) {
    const SegmentMotion& B = body[index(garment_.boards[i].segment)];
    const Moved place = moved(board_place_[i], g, errors_.tissue_place, time);
    const Moved angle = moved(board_angle_[i], g, errors_.tissue_angle, time);
    // Turned by the quaternion r = (1, angle / 2) over its length; w = 2 Im(r* r') / |r|^2.
    const Eigen::Vector3d half = 0.5 * angle.value, half1 = 0.5 * angle.first;
    const double norm2 = 1.0 + half.squaredNorm();
    const Eigen::Quaterniond turn(1.0 / std::sqrt(norm2), half.x() / std::sqrt(norm2),
                                  half.y() / std::sqrt(norm2), half.z() / std::sqrt(norm2));
    const Eigen::Vector3d w_tissue_S = (2.0 / norm2) * (half1 - half.cross(half1));

    const Eigen::Matrix3d& R_WB = B.X_WB.linear();
    const Eigen::Vector3d arm = R_WB * (X_BS_[i].translation() + place.value);
    const Eigen::Vector3d slide = R_WB * place.first;
    BoardTruth& out = boards[i];
    out.X_WS.linear() = R_WB * X_BS_[i].linear() * turn.toRotationMatrix();
    out.X_WS.translation() = B.X_WB.translation() + arm;
    out.X_WS.makeAffine();
    out.v = B.v + B.w.cross(arm) + slide;
    out.a = B.a + B.alpha.cross(arm) + B.w.cross(B.w.cross(arm)) + 2.0 * B.w.cross(slide) +
            R_WB * place.second;
    const Eigen::Matrix3d R_SW = out.X_WS.linear().transpose();
    out.gyro = R_SW * B.w + w_tissue_S;
    out.accel = R_SW * (out.a + kStandardGravity * Eigen::Vector3d::UnitZ());
  }
}

void WornGarment::sources_at(double time, const BodyMotion& body,
                             std::span<Eigen::Isometry3d> X_WU) const noexcept {
  const Liveliness g = liveliness(time);
  for (std::size_t i = 0; i < X_WU.size(); ++i) {
    X_WU[i] = X_BU_[i];
    if (!garment_.sources[i].segment) continue;
    X_WU[i].translation() += moved(source_place_[i], g, errors_.tissue_place, time).value;
    X_WU[i] = body[index(*garment_.sources[i].segment)].X_WB * X_WU[i];
  }
}

void WornGarment::limbs_at(const BodyMotion& body, std::span<Limb> limbs) const noexcept {
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const Capsule& capsule = capsules_[i];
    limbs[i] = {body[i].X_WB * capsule.p_BA, body[i].X_WB * capsule.p_BE, capsule.radius};
  }
}

void WornGarment::boards_at(double time, std::span<BoardTruth> boards) const noexcept {
  BodyMotion body;
  motion_.at(time, body);
  boards_at(time, body, boards);
}

void WornGarment::sources_at(double time, std::span<Eigen::Isometry3d> X_WU) const noexcept {
  BodyMotion body;
  motion_.at(time, body);
  sources_at(time, body, X_WU);
}

void WornGarment::at(double time, GarmentInstant& out) const {
  out.boards.resize(garment_.boards.size());
  out.sources.resize(garment_.sources.size());
  out.source_v.resize(garment_.sources.size());
  out.limbs.resize(kJointCount);
  BodyMotion body;
  motion_.at(time, body);
  boards_at(time, body, out.boards);
  sources_at(time, body, out.sources);
  for (std::size_t i = 0; i < out.sources.size(); ++i) {
    const auto& segment = garment_.sources[i].segment;
    out.source_v[i].setZero();
    if (!segment) continue;
    const SegmentMotion& B = body[index(*segment)];
    out.source_v[i] =
        B.v + B.w.cross(out.sources[i].translation() - B.X_WB.translation());  // tissue is slow
  }
  limbs_at(body, out.limbs);
}

double WornGarment::blocked(double time, std::size_t source, std::size_t board) const {
  GarmentInstant instant;
  at(time, instant);
  return 1.0 - acoustic_shadow(instant.sources[source].translation(),
                               instant.boards[board].X_WS.translation(), instant.limbs,
                               kSpeedOfSound / garment_.carrier_hz)
                   .amplitude;
}

}  // namespace secondskin::sim
