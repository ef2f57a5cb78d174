#include "server/wearable/estimate/body_filter.h"

#include <algorithm>
#include <boost/math/distributions/chi_squared.hpp>
#include <cmath>
#include <limits>
#include <stdexcept>

#include "motion/anatomy.h"
#include "motion/rotation.h"
#include "server/wearable/estimate/covariance.h"

namespace secondskin::server {
namespace {

using Eigen::Vector3d;

constexpr double kLongestStep = 0.02;   ///< of one prediction [s]
constexpr double kLongestGap = 5.0;     ///< that is predicted; beyond, time only jumps [s]
constexpr double kKnowledgeStep = 0.1;  ///< between two uses of what is known of bodies [s]
constexpr double kLimitSlack = 0.35;    ///< beyond anatomy's ranges, which bodies exceed [rad]
constexpr double kLimitSigma = 0.3;     ///< [rad]
// What is known of any body, used where it is more than the filter knows.
constexpr double kAnyAngle = 1.5, kAnyRate = 8.0, kAnyAcceleration = 150.0;  // [rad], /s, /s^2
constexpr double kAnyVelocity = 5.0, kAnyPush = 30.0;                        // [m/s], [m/s^2]
// How alike the members of a chain turn, of one use, ten a second. Their angles are not alike: a
// neck leans forward under a level head.
constexpr double kChainRate = 0.5;  ///< [rad/s]
// A board whose readings did not pass for so long is taken with less weight until they do.
constexpr int kPatience = 35;          ///< inertial readings
constexpr int kDistancePatience = 30;  ///< distances, of all sources
constexpr int kAlonePatience = 5;      ///< further observations, of all kinds
constexpr double kLeastConfidence = 0.05;
constexpr double kSaturated = 0.999;     ///< of a sensor's range
constexpr double kSpeedOfSound = 343.0;  ///< for how far a microphone moves on meanwhile [m/s]
constexpr double kHalfConfident = 0.5;   ///< sigma of a joint with confidence 1/2 [rad]
// The wearer stands still when the filter starts.
constexpr double kStartRate = 0.1, kStartAcceleration = 1.0;  // [rad/s], [rad/s^2]
constexpr double kStartVelocity = 0.1, kStartPush = 1.0;      // [m/s], [m/s^2]

std::array<double, 3> gates(double probability) {
  std::array<double, 3> result{};
  for (int rows = 1; rows <= 3; ++rows) {
    result[static_cast<std::size_t>(rows - 1)] =
        boost::math::quantile(boost::math::chi_squared(rows), probability);
  }
  return result;
}

double square(double v) noexcept { return v * v; }

// Finite and not at the end of the sensor's range.
bool within(const Vector3d& reading, double range) noexcept {
  return reading.allFinite() && reading.cwiseAbs().maxCoeff() < kSaturated * range;
}

int most_rows(const Garment& garment) {
  return static_cast<int>(std::max(3 * garment.boards.size(), 10 * kJointCount + 12));
}

/// How many readings of a board in a row did not pass.
struct BoardInVain {
  int gyro = 0, accel = 0, distance = 0;
};

}  // namespace

struct BodyFilter::State {
  State(const Skeleton& canonical, const Garment& garment,
        std::span<const Eigen::Isometry3d> places, const FilterSettings& s);

  double seconds_to(std::int64_t to) const noexcept {
    return static_cast<double>(to - stamp) * 1e-9;
  }
  /// Carries the state to a stamp that lies ahead. @returns false for one that is too old.
  bool reach(std::int64_t to) noexcept;
  void use_knowledge() noexcept;
  /// Uses `set`; tells what became of each board's readings.
  void use_boards(int BoardInVain::*in_vain_of, ReadingCounts BoardCounts::*counts_of, int patience,
                  InnovationFit& fit) noexcept;
  bool use_alone() noexcept;
  /// Carries the state to the stamp and uses what `observe(time)` puts into `set`.
  template <class Observe>
  bool alone(std::int64_t stamp_ns, bool sound, Observe observe) noexcept {
    if (!sound || !reach(stamp_ns)) return false;
    set.clear();
    observe(seconds_to(stamp_ns));
    return use_alone();
  }
  void inertial(const Measurement& measurement) noexcept;
  void distances(const Measurement& measurement) noexcept;
  void publish() noexcept;
  Vector3d rotation_sigma(int group) const noexcept;

  FilterSettings settings;
  BodyModel body;
  BodyState x;
  Covariance P;
  ObservationSet set;
  std::vector<double> error;
  std::vector<char> relax, passed;
  std::array<double, 3> gate;
  ProcessNoise noise;
  std::vector<Eigen::Quaterniond> q_BS;  ///< as assumed at first
  std::vector<double> gyro_range, accel_range;
  std::vector<BoardCounts> counts;
  std::vector<BoardInVain> in_vain;
  InnovationFit gyro_fit, accel_fit, distance_fit;
  int alone_in_vain = 0;  ///< further observations in a row that did not pass
  std::uint64_t late = 0;
  std::int64_t stamp = 0;
  double since_knowledge = 0.0;
  Pose pose;
};

BodyFilter::State::State(const Skeleton& canonical, const Garment& garment,
                         std::span<const Eigen::Isometry3d> places, const FilterSettings& s)
    : settings(s),
      body(canonical, garment, places),
      P(body.layout, most_rows(garment)),
      set(body.layout, most_rows(garment)),
      error(static_cast<std::size_t>(P.padded_size())),
      relax(static_cast<std::size_t>(most_rows(garment))),
      passed(relax.size()),
      gate(gates(s.gate)),
      noise{square(s.joint_jerk), square(s.root_turn_jerk), square(s.root_jerk),
            square(s.chain_jerk), square(s.gyro_bias_walk), square(s.accel_bias_walk),
            square(s.mount_walk), square(s.sound_walk)},
      counts(garment.boards.size()),
      in_vain(garment.boards.size()),
      pose(kJointCount) {
  x.groups.resize(static_cast<std::size_t>(body.layout.groups));
  x.boards.resize(garment.boards.size());
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    q_BS.emplace_back(places[b].linear());
    gyro_range.push_back(garment.boards[b].gyro_range);
    accel_range.push_back(garment.boards[b].accel_range);
  }
}

bool BodyFilter::State::reach(std::int64_t to) noexcept {
  if (to <= stamp) return stamp - to <= kOldest;
  double rest = seconds_to(to);
  stamp = to;
  if (rest > kLongestGap) rest = kLongestGap;
  while (rest > 0.0) {
    const double step = std::min(rest, kLongestStep);
    P.predict(x, step, noise);
    propagate(x, step);
    rest -= step;
    since_knowledge += step;
    if (settings.limits && since_knowledge >= kKnowledgeStep) use_knowledge();
  }
  return true;
}

// Joint limits, one-sided, and bounds on the motion of what is not measured.
void BodyFilter::State::use_knowledge() noexcept {
  since_knowledge = 0.0;
  const BodyLayout& layout = body.layout;
  set.clear();
  const auto variance = [&](int column) {
    return (P.at(column, column) + P.at(column + 1, column + 1) + P.at(column + 2, column + 2)) /
           3.0;
  };
  const auto bound = [&](int column, const Vector3d& value, double any) {
    if (variance(column) > square(any)) observe_columns(column, -value, square(any), set);
  };
  for (std::size_t i = 1; i < kJointCount; ++i) {
    const int group = layout.group_of[i];
    if (group == BodyLayout::kNoGroup) continue;
    const GroupState& state = x.groups[static_cast<std::size_t>(group)];
    const auto joint = static_cast<Joint>(i);
    const JointAngles angles = joint_angles(joint, state.q);
    JointAngles allowed = angles;
    for (std::size_t m = 0; m < allowed.size(); ++m) {
      const AngleRange& range = canonical_anatomy()[i].range[m];
      allowed[m] = std::clamp(angles[m], range.min - kLimitSlack, range.max + kLimitSlack);
    }
    if (allowed != angles) {
      observe_rotation_along(body, x, group, joint_rotation(joint, allowed), square(kLimitSigma),
                             set);
    }
    bound(layout.rotation(group, 0), rotation_vector(state.q), kAnyAngle);
    bound(layout.rotation(group, 1), state.w, kAnyRate);
    bound(layout.rotation(group, 2), state.dw, kAnyAcceleration);
  }
  for (const std::vector<int>& chain : layout.chains) {
    for (std::size_t i = 1; i < chain.size(); ++i) {
      const GroupState &a = x.groups[static_cast<std::size_t>(chain[i - 1])],
                       &b = x.groups[static_cast<std::size_t>(chain[i])];
      observe_likeness(layout.rotation(chain[i - 1], 1), layout.rotation(chain[i], 1), b.w - a.w,
                       square(kChainRate), set);
    }
  }
  bound(layout.rotation(0, 1), x.groups[0].w, kAnyRate);
  bound(layout.rotation(0, 2), x.groups[0].dw, kAnyAcceleration);
  bound(layout.root(1), x.v, kAnyVelocity);
  bound(layout.root(2), x.a, kAnyPush);
  if (set.size() == 0) return;
  // No gate: what is known of bodies is not in doubt.
  constexpr double kAll = std::numeric_limits<double>::max();
  std::fill(relax.begin(), relax.end(), 0);
  P.update(set, {kAll, kAll, kAll}, relax, passed, error);
  correct(layout, error, x);
}

void BodyFilter::State::use_boards(int BoardInVain::*in_vain_of,
                                   ReadingCounts BoardCounts::*counts_of, int patience,
                                   InnovationFit& fit) noexcept {
  for (std::size_t o = 0; o < set.rows.size(); ++o) {
    relax[o] = in_vain[set.tag[o]].*in_vain_of >= patience;
  }
  const UpdateResult result = P.update(set, gate, relax, passed, error);
  correct(body.layout, error, x);
  fit.nis += result.nis;
  fit.rows += static_cast<std::uint64_t>(result.rows);
  for (std::size_t o = 0; o < set.rows.size(); ++o) {
    int& vain = in_vain[set.tag[o]].*in_vain_of;
    ReadingCounts& count = counts[set.tag[o]].*counts_of;
    vain = passed[o] ? 0 : vain + 1;
    ++(passed[o] ? count.used : count.gated);
  }
}

bool BodyFilter::State::use_alone() noexcept {
  if (set.size() == 0) return false;
  std::fill(relax.begin(), relax.end(), alone_in_vain >= kAlonePatience);
  P.update(set, gate, relax, passed, error);
  correct(body.layout, error, x);
  publish();
  const bool all =
      std::all_of(passed.begin(), passed.begin() + static_cast<std::ptrdiff_t>(set.rows.size()),
                  [](char p) { return p != 0; });
  alone_in_vain = all ? 0 : alone_in_vain + 1;
  return all;
}

void BodyFilter::State::inertial(const Measurement& measurement) noexcept {
  const double time = seconds_to(measurement.stamp_ns);
  const std::size_t boards = std::min(measurement.boards.size(), counts.size());
  if (settings.use_gyro) {
    set.clear();
    for (std::size_t b = 0; b < boards; ++b) {
      const BoardReading& reading = measurement.boards[b];
      if (!reading.gyro_valid || !within(reading.gyro, gyro_range[b])) {
        ++counts[b].gyro.missing;
        continue;
      }
      observe_gyro(body, x, b, time, reading.gyro, square(settings.gyro_noise), settings.rate_error,
                   set);
    }
    use_boards(&BoardInVain::gyro, &BoardCounts::gyro, kPatience, gyro_fit);
  }
  if (settings.use_accel) {
    set.clear();
    for (std::size_t b = 0; b < boards; ++b) {
      const BoardReading& reading = measurement.boards[b];
      if (!reading.accel_valid || !within(reading.accel, accel_range[b])) {
        ++counts[b].accel.missing;
        continue;
      }
      observe_accel(body, x, b, time, reading.accel, square(settings.accel_noise),
                    settings.arm_sigma, set);
    }
    use_boards(&BoardInVain::accel, &BoardCounts::accel, kPatience, accel_fit);
  }
}

void BodyFilter::State::distances(const Measurement& measurement) noexcept {
  if (!settings.use_distances || measurement.source >= body.X_BU.size()) return;
  const double time = seconds_to(measurement.stamp_ns);
  const std::size_t boards = std::min(measurement.distances.size(), counts.size());
  set.clear();
  for (std::size_t b = 0; b < boards; ++b) {
    const DistanceReading& reading = measurement.distances[b];
    const bool fine = std::isfinite(reading.distance) && reading.distance > 0.0 &&
                      reading.confidence >= kLeastConfidence && reading.confidence <= 1.0;
    const double sigma = fine ? settings.distance_noise / reading.confidence : 0.0;
    if (!fine || !server::observe_distance(body, x, measurement.source, b, time,
                                           reading.distance / kSpeedOfSound, reading.distance,
                                           square(sigma), set)) {
      ++counts[b].distance.missing;
    }
  }
  use_boards(&BoardInVain::distance, &BoardCounts::distance, kDistancePatience, distance_fit);
}

Vector3d BodyFilter::State::rotation_sigma(int group) const noexcept {
  const int c = body.layout.rotation(group, 0);
  return Vector3d(P.at(c, c), P.at(c + 1, c + 1), P.at(c + 2, c + 2)).cwiseMax(0.0).cwiseSqrt();
}

void BodyFilter::State::publish() noexcept {
  pose.p_WR = x.p;
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const int group = body.layout.group_of[i];
    if (group == BodyLayout::kNoGroup) {
      pose.q_PB[i] = body.fixed[i];
      pose.confidence[i] = 0.0F;
      continue;
    }
    pose.q_PB[i] = x.groups[static_cast<std::size_t>(group)].q;
    const double sigma = rotation_sigma(group).norm();
    pose.confidence[i] = static_cast<float>(1.0 / (1.0 + square(sigma / kHalfConfident)));
  }
}

BodyFilter::BodyFilter(const Skeleton& canonical, const Garment& garment,
                       std::span<const Eigen::Isometry3d> X_BS, const FilterSettings& settings)
    : state_(std::make_unique<State>(canonical, garment, X_BS, settings)) {
  start(Pose(kJointCount), 0, {});
}
BodyFilter::~BodyFilter() = default;
BodyFilter::BodyFilter(BodyFilter&&) noexcept = default;
BodyFilter& BodyFilter::operator=(BodyFilter&&) noexcept = default;

void BodyFilter::start(const Pose& pose, std::int64_t stamp_ns, std::span<const BoardBias> biases) {
  State& s = *state_;
  const BodyLayout& layout = s.body.layout;
  if (pose.q_PB.size() != kJointCount || !pose.is_valid()) {
    throw std::invalid_argument("wearable filter: the first pose is not a valid canonical one");
  }
  if (!biases.empty() && biases.size() != s.x.boards.size()) {
    throw std::invalid_argument("wearable filter: not one bias per board");
  }
  s.stamp = stamp_ns;
  s.since_knowledge = 0.0;
  s.x.p = pose.p_WR;
  s.x.v = s.x.a = Vector3d::Zero();
  s.x.sound = 1.0;
  s.body.fixed = pose.q_PB;
  s.P.clear();
  const auto put = [&](int column, double sigma) {
    for (int c = column; c < column + 3; ++c) s.P.reset(c, square(sigma));
  };
  for (GroupState& group : s.x.groups) group = GroupState{};
  for (std::size_t i = 0; i < kJointCount; ++i) {
    const int group = layout.group_of[i];
    if (group == BodyLayout::kNoGroup) continue;
    s.x.groups[static_cast<std::size_t>(group)].q = pose.q_PB[i];
  }
  for (int g = 0; g < layout.groups; ++g) {
    put(layout.rotation(g, 0), s.settings.pose_sigma);
    put(layout.rotation(g, 1), kStartRate);
    put(layout.rotation(g, 2), kStartAcceleration);
  }
  put(layout.root(0), s.settings.pose_sigma);
  put(layout.root(1), kStartVelocity);
  put(layout.root(2), kStartPush);
  for (std::size_t b = 0; b < s.x.boards.size(); ++b) {
    const BoardBias bias = biases.empty() ? BoardBias{} : biases[b];
    s.x.boards[b] = {s.q_BS[b], bias.gyro, bias.accel};
    put(layout.gyro_bias(b), bias.gyro_sigma);
    put(layout.accel_bias(b), bias.accel_sigma);
    PathMotion path;
    evaluate(s.body.skeleton, layout, s.x, s.body.fixed, s.body.segment_of[b], 0.0, path);
    const Vector3d up_S = s.q_BS[b].conjugate() * path.end().R.transpose() * Vector3d::UnitZ();
    const Eigen::Matrix3d about_up = up_S * up_S.transpose();
    s.P.reset_block(layout.mount(b),
                    square(s.settings.mount_sigma) * about_up +
                        square(s.settings.mount_tilt) * (Eigen::Matrix3d::Identity() - about_up));
  }
  s.P.reset(layout.sound(), square(s.settings.sound_sigma));
  std::fill(s.in_vain.begin(), s.in_vain.end(), BoardInVain{});
  s.publish();
}

void BodyFilter::process(const Measurement& measurement) noexcept {
  State& s = *state_;
  if (!s.reach(measurement.stamp_ns)) {
    ++s.late;
    return;
  }
  if (measurement.kind == MeasurementKind::kInertial) {
    s.inertial(measurement);
  } else {
    s.distances(measurement);
  }
  s.publish();
}

bool BodyFilter::observe_root(std::int64_t stamp_ns, const Eigen::Isometry3d& X_WR, double sigma_p,
                              double sigma_q) noexcept {
  State& s = *state_;
  return s.alone(stamp_ns, X_WR.matrix().allFinite(), [&](double time) {
    observe_point(s.body, s.x, PointQuantity::kPosition, 0, Vector3d::Zero(), time,
                  X_WR.translation(), square(sigma_p), std::nullopt, s.set);
    observe_root_rotation(s.body, s.x, time, Eigen::Quaterniond(X_WR.linear()), square(sigma_q),
                          s.set);
  });
}

bool BodyFilter::observe_point_velocity(std::int64_t stamp_ns, std::size_t segment,
                                        const Vector3d& p_BQ, const Vector3d& v_W,
                                        double sigma) noexcept {
  State& s = *state_;
  return s.alone(stamp_ns, (p_BQ + v_W).allFinite(), [&](double time) {
    observe_point(s.body, s.x, PointQuantity::kVelocity, segment, p_BQ, time, v_W, square(sigma),
                  std::nullopt, s.set);
  });
}

bool BodyFilter::observe_point_position(std::int64_t stamp_ns, std::size_t segment,
                                        const Vector3d& p_BQ, const Vector3d& p_WQ,
                                        double sigma) noexcept {
  State& s = *state_;
  return s.alone(stamp_ns, (p_BQ + p_WQ).allFinite(), [&](double time) {
    observe_point(s.body, s.x, PointQuantity::kPosition, segment, p_BQ, time, p_WQ, square(sigma),
                  std::nullopt, s.set);
  });
}

bool BodyFilter::observe_point_height(std::int64_t stamp_ns, std::size_t segment,
                                      const Vector3d& p_BQ, double z, double sigma) noexcept {
  State& s = *state_;
  return s.alone(stamp_ns, p_BQ.allFinite() && std::isfinite(z), [&](double time) {
    observe_point(s.body, s.x, PointQuantity::kPosition, segment, p_BQ, time, {0.0, 0.0, z},
                  square(sigma), 2, s.set);
  });
}

bool BodyFilter::observe_direction(std::int64_t stamp_ns, std::size_t board,
                                   const Vector3d& field_S, const Vector3d& field_W,
                                   double sigma) noexcept {
  State& s = *state_;
  const double seen = field_S.norm(), known = field_W.norm();
  const bool sound = seen > 0.0 && known > 0.0 && std::isfinite(seen + known);
  return s.alone(stamp_ns, sound, [&](double time) {
    observe_field(s.body, s.x, board, time, field_S / seen, field_W / known, square(sigma), s.set);
  });
}

bool BodyFilter::observe_distance(std::int64_t stamp_ns, std::size_t board, const Vector3d& p_W,
                                  double distance, double sigma) noexcept {
  State& s = *state_;
  return s.alone(stamp_ns, p_W.allFinite() && std::isfinite(distance), [&](double time) {
    observe_distance_from(s.body, s.x, p_W, board, time, distance, square(sigma), s.set);
  });
}

const Pose& BodyFilter::pose() const noexcept { return state_->pose; }
std::int64_t BodyFilter::stamp_ns() const noexcept { return state_->stamp; }

Vector3d BodyFilter::sigma(Joint joint) const noexcept {
  const int group = state_->body.layout.group_of[index(joint)];
  if (group == BodyLayout::kNoGroup) return Vector3d::Constant(kAnyAngle);
  return state_->rotation_sigma(group);
}

Eigen::Matrix<double, 6, 6> BodyFilter::root_covariance() const noexcept {
  const BodyLayout& layout = state_->body.layout;
  const auto column = [&](int i) { return i < 3 ? layout.root(0) + i : i - 3; };
  Eigen::Matrix<double, 6, 6> result;
  for (int i = 0; i < 6; ++i) {
    for (int j = 0; j < 6; ++j) result(i, j) = state_->P.at(column(i), column(j));
  }
  return result;
}

Vector3d BodyFilter::root_velocity() const noexcept { return state_->x.v; }

Vector3d BodyFilter::joint_rate(Joint joint) const noexcept {
  const int group = state_->body.layout.group_of[index(joint)];
  if (group == BodyLayout::kNoGroup) return Vector3d::Zero();
  return state_->x.groups[static_cast<std::size_t>(group)].w;
}

Vector3d BodyFilter::point_position(std::size_t segment, const Vector3d& p_BQ) const noexcept {
  const State& s = *state_;
  PathMotion path;
  evaluate(s.body.skeleton, s.body.layout, s.x, s.body.fixed, segment, 0.0, path);
  return point(path, p_BQ).p;
}

Vector3d BodyFilter::point_velocity(std::size_t segment, const Vector3d& p_BQ) const noexcept {
  const State& s = *state_;
  PathMotion path;
  evaluate(s.body.skeleton, s.body.layout, s.x, s.body.fixed, segment, 0.0, path);
  return point(path, p_BQ).v;
}

Eigen::Isometry3d BodyFilter::X_BS(std::size_t board) const noexcept {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.linear() = state_->x.boards[board].q_BS.toRotationMatrix();
  X.translation() = state_->body.p_BS[board];
  return X;
}

BoardBias BodyFilter::bias(std::size_t board) const noexcept {
  const State& s = *state_;
  const BodyLayout& layout = s.body.layout;
  const auto sigma = [&](int c) {
    return std::sqrt((s.P.at(c, c) + s.P.at(c + 1, c + 1) + s.P.at(c + 2, c + 2)) / 3.0);
  };
  return {s.x.boards[board].gyro_bias, s.x.boards[board].accel_bias, sigma(layout.gyro_bias(board)),
          sigma(layout.accel_bias(board))};
}

double BodyFilter::sound_scale() const noexcept { return state_->x.sound; }
std::span<const BoardCounts> BodyFilter::counts() const noexcept { return state_->counts; }
std::uint64_t BodyFilter::late() const noexcept { return state_->late; }
InnovationFit BodyFilter::gyro_fit() const noexcept { return state_->gyro_fit; }
InnovationFit BodyFilter::accel_fit() const noexcept { return state_->accel_fit; }
InnovationFit BodyFilter::distance_fit() const noexcept { return state_->distance_fit; }
const BodyState& BodyFilter::estimate() const noexcept { return state_->x; }
const BodyLayout& BodyFilter::layout() const noexcept { return state_->body.layout; }
const Covariance& BodyFilter::covariance() const noexcept { return state_->P; }

}  // namespace secondskin::server
