#include "coach/correct/correction_model.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <stdexcept>

#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;

// What counts as one unit of error: ten degrees of a joint, ten centimetres of a hand.
constexpr double kAngleScale = 10.0 * kDegree;
constexpr double kPositionScale = 0.10;
// Hands, feet and head: how much they count beside the joints, and what is near enough.
constexpr double kTaskWeight = 1.0;
constexpr double kTaskDeadBand = 0.03;
// Rounding of the dead band's edge, as a share of the scale.
constexpr double kRounding = 0.1;
// A joint of weight 1 is asked when that takes more than 0.3 units off its error: three degrees.
constexpr double kPrice = 0.3;
constexpr double kLeastPrice = 1e-3;  // keeps the two signs of a correction apart
// Smoothness: the jerk of a minimum-jerk movement is proportional to its amount.
constexpr double kEffort = 0.02;
// A learner's lead over the reference's velocity fades with this time constant [s], and turns a
// joint by no more than this [rad].
constexpr double kVelocityMemory = 0.03;
// What the present error differs from the usual one fades as people correct themselves: within a
// visual reaction [s].
constexpr double kDeviationMemory = 0.25;
constexpr double kLargestDrift = 20.0 * kDegree;
// The peak velocity of a minimum-jerk movement over its mean.
constexpr double kPeakVelocity = 1.875;
// Corrections that nobody would feel as one.
constexpr double kSmallestAsked = 1.0 * kDegree;

constexpr std::size_t kLastKnot = kKnots - 1;

double wrapped(double angle) noexcept { return std::remainder(angle, 2.0 * std::numbers::pi); }

// w_PB_B = rate * d(angles)/dt for the convention of the joint (eq. 4).
Eigen::Matrix3d angle_rate(std::size_t joint, const JointAngles& angles) noexcept {
  const JointAnatomy& anatomy = canonical_anatomy()[joint];
  const auto& axis = anatomy.axis;
  Eigen::Matrix3d rate;
  if (anatomy.convention == AngleConvention::kSwingTwist) {
    const Eigen::Matrix3d R_twist =
        quaternion_from(angles[2] * axis[2]).conjugate().toRotationMatrix();
    const Eigen::Matrix3d J = R_twist * right_jacobian(angles[0] * axis[0] + angles[1] * axis[1]);
    rate.col(0) = J * axis[0];
    rate.col(1) = J * axis[1];
    rate.col(2) = axis[2];
    return rate;
  }
  const bool vertical_first = anatomy.convention == AngleConvention::kCardanZXY;
  const std::size_t outer = vertical_first ? 2 : 0;
  const std::size_t inner = vertical_first ? 0 : 2;
  const Eigen::Matrix3d R_inner =
      quaternion_from(angles[inner] * axis[inner]).conjugate().toRotationMatrix();
  const Eigen::Matrix3d R_middle =
      quaternion_from(angles[1] * axis[1]).conjugate().toRotationMatrix();
  rate.col(static_cast<Eigen::Index>(inner)) = axis[inner];
  rate.col(1) = R_inner * axis[1];
  rate.col(static_cast<Eigen::Index>(outer)) = R_inner * (R_middle * axis[outer]);
  return rate;
}

// How that map changes with each angle, for eq. 10 and 11: element k has the columns
// d(rate.col(i))/d(angles[k]).
std::array<Eigen::Matrix3d, 3> angle_rate_change(std::size_t joint, const JointAngles& angles,
                                                 const Eigen::Matrix3d& rate) noexcept {
  const JointAnatomy& anatomy = canonical_anatomy()[joint];
  std::array<Eigen::Matrix3d, 3> change;
  for (Eigen::Matrix3d& m : change) m.setZero();
  // A movement turns what is applied outside of it.
  const auto turns = [&](Eigen::Index inner, Eigen::Index outer) {
    change[static_cast<std::size_t>(inner)].col(outer) = rate.col(outer).cross(rate.col(inner));
  };
  if (anatomy.convention != AngleConvention::kSwingTwist) {
    const bool vertical_first = anatomy.convention == AngleConvention::kCardanZXY;
    const Eigen::Index outer = vertical_first ? 2 : 0, inner = vertical_first ? 0 : 2;
    turns(inner, outer);
    turns(inner, 1);
    turns(1, outer);
    return change;
  }
  turns(2, 0);
  turns(2, 1);
  const auto& axis = anatomy.axis;
  const Eigen::Vector3d s = angles[0] * axis[0] + angles[1] * axis[1];
  const double squared = s.squaredNorm(), angle = std::sqrt(squared);
  const bool small = angle < 1e-2;
  const double sine = std::sin(angle), cosine = std::cos(angle);
  // J_r = I - a [s] + b [s]^2; da and db are the derivatives of a and b by |s|, over |s|.
  const double a = small ? 0.5 - squared / 24.0 : (1.0 - cosine) / squared;
  const double b = small ? 1.0 / 6.0 - squared / 120.0 : (angle - sine) / (squared * angle);
  const double da = small ? -1.0 / 12.0 + squared / 180.0 : (sine / angle - 2.0 * a) / squared;
  const double db =
      small ? -1.0 / 60.0 + squared / 1260.0 : ((1.0 - cosine) / squared - 3.0 * b) / squared;
  const Eigen::Matrix3d cross = cross_matrix(s);
  const Eigen::Matrix3d R_twist =
      quaternion_from(angles[2] * axis[2]).conjugate().toRotationMatrix();
  for (std::size_t k = 0; k < 2; ++k) {
    const Eigen::Matrix3d cross_k = cross_matrix(axis[k]);
    const double along = s.dot(axis[k]);
    const Eigen::Matrix3d dJ = -da * along * cross - a * cross_k + db * along * cross * cross +
                               b * (cross_k * cross + cross * cross_k);
    for (std::size_t i = 0; i < 2; ++i) {
      change[k].col(static_cast<Eigen::Index>(i)) = R_twist * (dJ * axis[i]);
    }
  }
  return change;
}

// The pelvis without its heading: the part of its orientation that gravity sees.
Eigen::Quaterniond without_heading(const Eigen::Quaterniond& q_WR) noexcept {
  JointAngles angles = joint_angles(Joint::kPelvis, q_WR);
  angles[static_cast<std::size_t>(Movement::kRotation)] = 0.0;
  return joint_rotation(Joint::kPelvis, angles);
}

bool finite(const Eigen::Quaterniond& q) noexcept {
  return q.coeffs().allFinite() && std::abs(q.norm() - 1.0) < 1e-2;
}

// Half the square of an error beyond its dead band, rounded at its edge so that it is smooth
// everywhere (eq. 3): the value, the gradient is `first` * e, and the Hessian is
// `first` * I + `second` * e * e^T.
struct Penalty {
  double value, first, second;

  Penalty(const Eigen::Vector3d& e, double dead_band, double scale) noexcept {
    const double rounding = kRounding * scale;
    const double m = std::sqrt(e.squaredNorm() + rounding * rounding);
    const double x = m - dead_band;
    const double root = std::sqrt(x * x + rounding * rounding);
    const double r = 0.5 * (x + root) / scale;
    const double dr = 0.5 * (1.0 + x / root) / scale;
    const double ddr = 0.5 * rounding * rounding / (root * root * root) / scale;
    value = 0.5 * r * r;
    first = r * dr / m;
    second = (dr * dr + r * ddr - first) / (m * m);
  }
};

Eigen::Index as_index(std::size_t i) noexcept { return static_cast<Eigen::Index>(i); }

}  // namespace

double minimum_jerk(double s) noexcept { return s * s * s * (10.0 + s * (6.0 * s - 15.0)); }

Eigen::Quaterniond reference_rotation(const Reference& reference, double time,
                                      std::size_t joint) noexcept {
  const auto& poses = reference.motion.poses;
  const double last = static_cast<double>(poses.size() - 1);
  const double at = std::clamp(time * reference.motion.rate_hz, 0.0, last);
  const auto before = static_cast<std::size_t>(at);
  const std::size_t after = std::min(before + 1, poses.size() - 1);
  return poses[before].q_PB[joint].slerp(at - static_cast<double>(before),
                                         poses[after].q_PB[joint]);
}

CorrectionModel::CorrectionModel(std::shared_ptr<const Reference> reference,
                                 const Skeleton& learner, const CorrectionOptions& options)
    : reference_(std::move(reference)), skeleton_(learner), options_(options) {
  if (!is_canonical(skeleton_) || !reference_ || !is_canonical(reference_->motion.skeleton) ||
      reference_->motion.poses.empty()) {
    throw std::invalid_argument(
        "CorrectionModel: learner and reference must have the canonical joints");
  }
  if (!(options_.horizon > 0.0) || !(options_.tolerance_scale >= 0.0) ||
      !(options_.sparsity >= 0.0)) {
    throw std::invalid_argument(
        "CorrectionModel: horizon must be > 0, tolerance_scale and sparsity >= 0");
  }
  const auto& anatomy = canonical_anatomy();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    for (std::size_t movement = 0; movement < 3; ++movement) {
      const AngleRange& range = anatomy[j].range[movement];
      // The heading of the pelvis is the learner's own.
      const bool heading =
          j == index(Joint::kPelvis) && movement == static_cast<std::size_t>(Movement::kRotation);
      freedom_of_[j][movement] = -1;
      if (range.min == range.max || heading) continue;
      freedom_of_[j][movement] = static_cast<int>(freedoms_.size());
      freedoms_.push_back({static_cast<Joint>(j), static_cast<Movement>(movement)});
    }
    moves_[j].fill(false);
    for (std::optional<std::size_t> segment = j; segment; segment = skeleton_[*segment].parent) {
      moves_[*segment][j] = true;
    }
  }
  price_ = std::max(kPrice * options_.sparsity, kLeastPrice) / kAngleScale;
  joint_price_ = 0.5 * (kPrice * options_.sparsity) * (kPrice * options_.sparsity);

  double mass = 0.0;
  for (const Segment& segment : skeleton_.segments()) mass += segment.mass_fraction;
  constraints_ = reference_->standing && mass > 0.0 ? kDirections : 0;

  for (std::size_t k = 0; k < kKnots; ++k) {
    knots_[k].share = minimum_jerk(static_cast<double>(k + 1) / kKnots);
  }
  double squares = 0.0;
  for (const Knot& knot : knots_) squares += knot.share * knot.share;
  for (Knot& knot : knots_) knot.weight = knot.share * knot.share / squares;

  lower_.assign(size(), 0.0);
  upper_.assign(size(), 0.0);
  room_below_.assign(size(), 0.0);
  room_above_.assign(size(), 0.0);
  balance_limit_.assign(constraints_, 0.0);
  Pose rest(kJointCount);
  pose({.frame = 0, .stamp_ns = 0, .learner = rest});
}

bool CorrectionModel::pose(const CorrectionProblem& problem) {
  placed_.clear();
  const bool sound = problem.learner.q_PB.size() == kJointCount &&
                     problem.learner.confidence.size() == kJointCount &&
                     std::isfinite(problem.reference_time) && std::isfinite(problem.tempo);
  if (!sound) {
    compared_.reset();
    candidate_.reset();
    open_.reset();
    tip_weight_.fill(0.0);
    std::fill(lower_.begin(), lower_.end(), 0.0);
    std::fill(upper_.begin(), upper_.end(), 0.0);
    std::fill(balance_limit_.begin(), balance_limit_.end(), 1e3);
    return false;
  }
  predict(problem);
  open_joints(problem.askable);
  bound();
  return true;
}

void CorrectionModel::predict(const CorrectionProblem& problem) {
  const double now = problem.reference_time;
  const double tempo = std::clamp(problem.tempo, 0.0, 3.0);
  const auto& poses = reference_->motion.poses;
  const double last = static_cast<double>(poses.size() - 1);
  const auto nearest =
      static_cast<std::size_t>(std::clamp(now * reference_->motion.rate_hz, 0.0, last) + 0.5);
  const Pose& reference_pose = poses[std::min(nearest, poses.size() - 1)];

  const double known = problem.habit.known(now);
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const bool root = j == index(Joint::kPelvis);
    const Eigen::Quaterniond& given = problem.learner.q_PB[j];
    const double confidence = problem.learner.confidence[j];
    const Eigen::Quaterniond q_ref = reference_rotation(*reference_, now, j);
    dead_band_[j] = reference_->tolerance_at(now, j) * options_.tolerance_scale;
    measured_[j] = finite(given) && confidence > 0.0;
    const bool compared =
        measured_[j] && reference_->weight[j] > 0.0 &&
        (reference_pose.confidence.size() != kJointCount || reference_pose.confidence[j] > 0.0f);
    weight_[j] = compared ? reference_->weight[j] * std::min(confidence, 1.0) : 0.0;

    // A joint that no sensor sees stays as the capture says; one without a number, as the expert's.
    const Eigen::Quaterniond q = finite(given) ? given.normalized() : q_ref;
    const auto settle = [&](const Eigen::Quaterniond& q_PB) {
      return root ? without_heading(q_PB) : q_PB;
    };
    present_[j] = settle(q);
    present_angles_[j] = joint_angles(static_cast<Joint>(j), present_[j]);
    present_error_[j] = rotation_vector(present_[j].conjugate() * settle(q_ref));

    // The learner goes on as the expert does, keeps the error of now, and drifts with what is left
    // of the difference in velocity (eq. 5).
    constexpr double kStep = 1.0 / kReferenceRate;
    Eigen::Vector3d lead = Eigen::Vector3d::Zero();
    if (measured_[j] && problem.velocity[j].allFinite()) {
      const Eigen::Quaterniond q_next = reference_rotation(*reference_, now + tempo * kStep, j);
      lead = problem.velocity[j] - rotation_vector(q_ref.conjugate() * q_next) / kStep;
    }
    const Eigen::Vector3d habit_now = problem.habit.at(now, j);
    for (std::size_t k = 0; k < kKnots; ++k) {
      const double ahead = options_.horizon * static_cast<double>(k + 1) / kKnots;
      const Eigen::Quaterniond q_then = reference_rotation(*reference_, now + tempo * ahead, j);
      Eigen::Vector3d drift = lead * kVelocityMemory * -std::expm1(-ahead / kVelocityMemory);
      const double amount = drift.norm();
      if (amount > kLargestDrift) drift *= kLargestDrift / amount;
      // eq. 5b
      const double fades = -std::expm1(-ahead / kDeviationMemory);
      drift -= problem.habit.at(now + tempo * ahead, j) - habit_now -
               fades * (known * present_error_[j] - habit_now);
      const Eigen::Quaterniond predicted =
          measured_[j] ? q * (q_ref.conjugate() * q_then) * quaternion_from(drift) : q;
      knots_[k].angles[j] = joint_angles(static_cast<Joint>(j), settle(predicted.normalized()));
      knots_[k].reference[j] = settle(q_then);
      knots_[k].dead_band[j] =
          reference_->tolerance_at(now + tempo * ahead, j) * options_.tolerance_scale;
    }
  }

  // Hands, feet and head; where one is not measured, the wrist, the ankle or the neck's end.
  struct Limb {
    Joint first, root, fallback, tip;
    Joint last;
  };
  static constexpr std::array<Limb, kTips> kLimbs{{
      {Joint::kLeftClavicle, Joint::kLeftShoulder, Joint::kLeftElbow, Joint::kLeftWrist,
       Joint::kLeftWrist},
      {Joint::kRightClavicle, Joint::kRightShoulder, Joint::kRightElbow, Joint::kRightWrist,
       Joint::kRightWrist},
      {Joint::kLeftHip, Joint::kLeftHip, Joint::kLeftKnee, Joint::kLeftAnkle, Joint::kLeftToes},
      {Joint::kRightHip, Joint::kRightHip, Joint::kRightKnee, Joint::kRightAnkle,
       Joint::kRightToes},
      {Joint::kNeck, Joint::kPelvis, Joint::kNeck, Joint::kHead, Joint::kHead},
  }};
  for (std::size_t t = 0; t < kTips; ++t) {
    const Limb& limb = kLimbs[t];
    tip_segment_[t] = measured_[index(limb.tip)] ? limb.tip : limb.fallback;
    const bool seen = measured_[index(limb.root)] && measured_[index(tip_segment_[t])];
    double weight = 0.0;
    for (std::size_t j = index(limb.first); j <= index(limb.last); ++j) {
      weight = std::max(weight, weight_[j]);
    }
    tip_weight_[t] = seen ? kTaskWeight * weight : 0.0;
  }
  // The expert's orientations on the learner's own bones (eq. 2).
  for (Knot& knot : knots_) {
    std::array<Eigen::Matrix3d, kJointCount> R_HB;
    std::array<Eigen::Vector3d, kJointCount> p_HB;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      const Eigen::Matrix3d R_PB = knot.reference[j].toRotationMatrix();
      if (const auto parent = skeleton_[j].parent) {
        R_HB[j] = R_HB[*parent] * R_PB;
        p_HB[j] = p_HB[*parent] + R_HB[*parent] * skeleton_[j].p_PB;
      } else {
        R_HB[j] = R_PB;
        p_HB[j].setZero();
      }
    }
    for (std::size_t t = 0; t < kTips; ++t) {
      const std::size_t s = index(tip_segment_[t]);
      knot.tip[t] = p_HB[s] + R_HB[s] * skeleton_[s].p_BE;
    }
  }
}

void CorrectionModel::open_joints(const JointSet& askable) {
  for (std::size_t j = 0; j < kJointCount; ++j) {
    bool outside = present_error_[j].norm() > dead_band_[j];
    for (const Knot& knot : knots_) {
      const Eigen::Quaterniond q = joint_rotation(static_cast<Joint>(j), knot.angles[j]);
      outside = outside || geodesic_distance(q, knot.reference[j]) > knot.dead_band[j];
    }
    compared_[j] = weight_[j] > 0.0 && outside;
  }
  candidate_ = compared_ & askable;
  open_ = candidate_;
}

Eigen::Vector3d CorrectionModel::expected_error(std::size_t joint) const noexcept {
  const Knot& knot = knots_[kLastKnot];
  const Eigen::Quaterniond q = joint_rotation(static_cast<Joint>(joint), knot.angles[joint]);
  return rotation_vector(q.conjugate() * knot.reference[joint]);
}

void CorrectionModel::restrict_to(const JointSet& joints) noexcept {
  open_ = candidate_ & joints;
  for (std::size_t i = 0; i < size(); ++i) {
    const bool open = open_[index(freedoms_[i].joint)];
    lower_[i] = open ? room_below_[i] : 0.0;
    upper_[i] = open ? room_above_[i] : 0.0;
  }
  placed_.clear();
}

bool CorrectionModel::coupled(std::size_t a, std::size_t b) const noexcept {
  const std::size_t i = index(freedoms_[a].joint), j = index(freedoms_[b].joint);
  if (moves_[i][j] || moves_[j][i]) return true;
  for (const Joint end : {Joint::kLeftWrist, Joint::kRightWrist, Joint::kLeftAnkle,
                          Joint::kRightAnkle, Joint::kHead}) {
    if (moves_[i][index(end)] && moves_[j][index(end)]) return true;
  }
  return false;
}

void CorrectionModel::bound() {
  const auto& anatomy = canonical_anatomy();
  const double interval = options_.horizon / kKnots;
  for (std::size_t i = 0; i < size(); ++i) {
    const std::size_t j = index(freedoms_[i].joint);
    const auto movement = static_cast<std::size_t>(freedoms_[i].movement);
    const AngleRange& range = anatomy[j].range[movement];
    const double fastest = anatomy[j].max_speed[movement];
    // Eq. 7: the whole correction stays inside the joint's range, now and at every knot.
    double low = range.min - present_angles_[j][movement];
    double high = range.max - present_angles_[j][movement];
    // Eq. 8: so does its speed, at the peak of the movement and on the way from knot to knot.
    const double reach = fastest * options_.horizon / kPeakVelocity;
    low = std::max(low, -reach);
    high = std::min(high, reach);
    double before = present_angles_[j][movement], done = 0.0;
    for (const Knot& knot : knots_) {
      const double angle = knot.angles[j][movement];
      low = std::max(low, range.min - angle);
      high = std::min(high, range.max - angle);
      const double free = wrapped(angle - before);
      const double share = knot.share - done;
      low = std::max(low, (-fastest * interval - free) / share);
      high = std::min(high, (fastest * interval - free) / share);
      before = angle;
      done = knot.share;
    }
    // A learner who is outside already need not come back, but must not go further.
    room_below_[i] = open_[j] ? std::min(low, 0.0) : 0.0;
    room_above_[i] = open_[j] ? std::max(high, 0.0) : 0.0;
  }
  lower_ = room_below_;
  upper_ = room_above_;
  if (constraints_ == 0) return;
  // Eq. 9, at the last knot.
  const std::vector<double> none(size(), 0.0);
  balance(none, balance_limit_);
  const bool legs = measured_[index(Joint::kLeftHip)] && measured_[index(Joint::kLeftKnee)] &&
                    measured_[index(Joint::kRightHip)] && measured_[index(Joint::kRightKnee)];
  std::array<Eigen::Vector3d, 4> points;
  support(kLastKnot, points);
  const Eigen::Vector3d centre = 0.25 * (points[0] + points[1] + points[2] + points[3]);
  for (std::size_t c = 0; c < kDirections; ++c) {
    const double angle = 2.0 * std::numbers::pi * static_cast<double>(c) / kDirections;
    const Eigen::Vector3d direction(std::cos(angle), std::sin(angle), 0.0);
    for (const Eigen::Vector3d& p : points) {
      balance_limit_[c] = std::max(balance_limit_[c], direction.dot(p - centre));
    }
    if (!legs) balance_limit_[c] = 1e3;
  }
}

void CorrectionModel::place(std::span<const double> delta) {
  if (placed_.size() == delta.size() && std::equal(delta.begin(), delta.end(), placed_.begin())) {
    return;
  }
  for (std::size_t k = 0; k < kKnots; ++k) place_segments(delta, k);
  placed_.assign(delta.begin(), delta.end());
}

void CorrectionModel::place_segments(std::span<const double> delta, std::size_t k) {
  const Knot& knot = knots_[k];
  Placement& placement = placement_[k];
  for (std::size_t j = 0; j < kJointCount; ++j) {
    JointAngles angles = knot.angles[j];
    if (open_[j]) {
      for (std::size_t movement = 0; movement < 3; ++movement) {
        const int i = freedom_of_[j][movement];
        if (i >= 0) angles[movement] += delta[static_cast<std::size_t>(i)];
      }
      placement.rate[j] = angle_rate(j, angles);
      placement.angles[j] = angles;
    }
    const Eigen::Quaterniond q_PB = joint_rotation(static_cast<Joint>(j), angles);
    placement.error[j] = rotation_vector(q_PB.conjugate() * knot.reference[j]);
    const Eigen::Matrix3d R_PB = q_PB.toRotationMatrix();
    if (const auto parent = skeleton_[j].parent) {
      placement.R_HB[j] = placement.R_HB[*parent] * R_PB;
      placement.p_HB[j] = placement.p_HB[*parent] + placement.R_HB[*parent] * skeleton_[j].p_PB;
    } else {
      placement.R_HB[j] = R_PB;
      placement.p_HB[j].setZero();
    }
  }
  for (std::size_t t = 0; t < kTips; ++t) {
    const std::size_t s = index(tip_segment_[t]);
    placement.tip_error[t] =
        placement.p_HB[s] + placement.R_HB[s] * skeleton_[s].p_BE - knot.tip[t];
  }
}

double CorrectionModel::error(std::span<const double> delta) {
  double sum = task_error(delta);
  for (std::size_t k = 0; k < kKnots; ++k) {
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (!compared_[j]) continue;
      sum += knots_[k].weight * weight_[j] *
             Penalty(placement_[k].error[j], knots_[k].dead_band[j], kAngleScale).value;
    }
  }
  return sum;
}

double CorrectionModel::task_error(std::span<const double> delta) {
  place(delta);
  double sum = 0.0;
  for (std::size_t k = 0; k < kKnots; ++k) {
    for (std::size_t t = 0; t < kTips; ++t) {
      sum += knots_[k].weight * tip_weight_[t] *
             Penalty(placement_[k].tip_error[t], kTaskDeadBand, kPositionScale).value;
    }
  }
  return sum;
}

double CorrectionModel::cost(std::span<const double> delta) {
  double effort = 0.0;
  for (std::size_t i = 0; i < size(); ++i) {
    if (open_[index(freedoms_[i].joint)]) effort += delta[i] * delta[i];
  }
  return error(delta) + 0.5 * kEffort * effort / (kAngleScale * kAngleScale);
}

// The velocity in H of a point of a moved segment for a unit rate of one movement.
Eigen::Vector3d CorrectionModel::lever(std::size_t freedom, std::size_t k,
                                       const Eigen::Vector3d& p) const {
  const std::size_t j = index(freedoms_[freedom].joint);
  const Placement& placement = placement_[k];
  const Eigen::Vector3d axis =
      placement.R_HB[j] *
      placement.rate[j].col(static_cast<Eigen::Index>(freedoms_[freedom].movement));
  return axis.cross(p - placement.p_HB[j]);
}

void CorrectionModel::gradient(std::span<const double> delta, std::span<double> out) {
  place(delta);
  for (std::size_t i = 0; i < size(); ++i) {
    out[i] =
        open_[index(freedoms_[i].joint)] ? kEffort * delta[i] / (kAngleScale * kAngleScale) : 0.0;
  }
  for (std::size_t k = 0; k < kKnots; ++k) {
    const Placement& placement = placement_[k];
    std::array<Eigen::Vector3d, kTips> pull, tip;
    for (std::size_t t = 0; t < kTips; ++t) {
      const Eigen::Vector3d& d = placement.tip_error[t];
      pull[t] =
          knots_[k].weight * tip_weight_[t] * Penalty(d, kTaskDeadBand, kPositionScale).first * d;
      tip[t] = d + knots_[k].tip[t];
    }
    for (std::size_t i = 0; i < size(); ++i) {
      const std::size_t j = index(freedoms_[i].joint);
      if (!open_[j]) continue;
      // log(exp(-w) exp(e)) = e - J_l^-1(e) w, and e^T J_l^-1(e) = e^T.
      const Eigen::Vector3d& e = placement.error[j];
      const double first = Penalty(e, knots_[k].dead_band[j], kAngleScale).first;
      out[i] -= knots_[k].weight * weight_[j] * first *
                e.dot(placement.rate[j].col(static_cast<Eigen::Index>(freedoms_[i].movement)));
      for (std::size_t t = 0; t < kTips; ++t) {
        if (moves_[j][index(tip_segment_[t])]) out[i] += pull[t].dot(lever(i, k, tip[t]));
      }
    }
  }
}

void CorrectionModel::hessian(std::span<const double> delta, std::span<double> out) {
  place(delta);
  const std::size_t n = size();
  std::fill(out.begin(), out.end(), 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    if (open_[index(freedoms_[i].joint)]) out[i * n + i] = kEffort / (kAngleScale * kAngleScale);
  }
  for (std::size_t k = 0; k < kKnots; ++k) {
    const Placement& placement = placement_[k];
    const double knot_weight = knots_[k].weight;
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (!open_[j]) continue;
      const Eigen::Vector3d& e = placement.error[j];
      const Penalty penalty(e, knots_[k].dead_band[j], kAngleScale);
      const Eigen::Matrix3d D = right_jacobian_inverse(e).transpose() * placement.rate[j];
      const Eigen::Matrix3d block = knot_weight * weight_[j] *
                                    (penalty.first * (D.transpose() * D) +
                                     penalty.second * (D.transpose() * e) * (e.transpose() * D));
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) {
          const int row = freedom_of_[j][a], column = freedom_of_[j][b];
          if (row < 0 || column < 0) continue;
          out[static_cast<std::size_t>(row) * n + static_cast<std::size_t>(column)] +=
              block(as_index(a), as_index(b));
        }
      }
    }
    add_task_hessian(k, out);
  }
}

// The generalised Gauss-Newton part of hands, feet and head.
void CorrectionModel::add_task_hessian(std::size_t k, std::span<double> out) const {
  const Placement& placement = placement_[k];
  const std::size_t n = size();
  for (std::size_t t = 0; t < kTips; ++t) {
    if (tip_weight_[t] == 0.0) continue;
    const Eigen::Vector3d& d = placement.tip_error[t];
    const Eigen::Vector3d p = d + knots_[k].tip[t];
    const Penalty penalty(d, kTaskDeadBand, kPositionScale);
    const double w = knots_[k].weight * tip_weight_[t];
    std::array<std::size_t, 3 * kJointCount> moving{};
    std::array<Eigen::Vector3d, 3 * kJointCount> column;
    std::size_t count = 0;
    for (std::size_t i = 0; i < n; ++i) {
      const std::size_t j = index(freedoms_[i].joint);
      if (!open_[j] || !moves_[j][index(tip_segment_[t])]) continue;
      moving[count] = i;
      column[count++] = lever(i, k, p);
    }
    for (std::size_t a = 0; a < count; ++a) {
      for (std::size_t b = 0; b < count; ++b) {
        out[moving[a] * n + moving[b]] +=
            w * (penalty.first * column[a].dot(column[b]) +
                 penalty.second * column[a].dot(d) * column[b].dot(d));
      }
    }
  }
}

// The second derivative of a point's place by two movements: of one joint, or the first of a joint
// nearer to the root. The point is moved by both (eq. 10).
Eigen::Vector3d CorrectionModel::acceleration(std::size_t proximal, std::size_t distal,
                                              std::size_t k, const Eigen::Vector3d& p) const {
  const Placement& placement = placement_[k];
  const std::size_t i = index(freedoms_[proximal].joint), j = index(freedoms_[distal].joint);
  const auto a = static_cast<Eigen::Index>(freedoms_[proximal].movement);
  const auto b = static_cast<Eigen::Index>(freedoms_[distal].movement);
  const Eigen::Vector3d axis = placement.R_HB[i] * placement.rate[i].col(a);
  Eigen::Vector3d second = axis.cross(lever(distal, k, p));
  if (i == j) {
    const Eigen::Vector3d turning = placement.rate[i].col(b).cross(placement.rate[i].col(a)) +
                                    placement.rate_change[i][static_cast<std::size_t>(b)].col(a);
    second += (placement.R_HB[i] * turning).cross(p - placement.p_HB[i]);
  }
  return second;
}

void CorrectionModel::exact_hessian(std::span<const double> delta, double factor,
                                    std::span<const double> multipliers, std::span<double> out) {
  place(delta);
  const std::size_t n = size();
  std::fill(out.begin(), out.end(), 0.0);
  for (std::size_t i = 0; i < n; ++i) {
    if (open_[index(freedoms_[i].joint)]) out[i * n + i] = kEffort / (kAngleScale * kAngleScale);
  }
  const auto add = [&](std::size_t row, std::size_t column, double value) {
    out[row * n + column] += value;
    if (row != column) out[column * n + row] += value;
  };
  for (std::size_t k = 0; k < kKnots; ++k) {
    Placement& placement = placement_[k];
    for (std::size_t j = 0; j < kJointCount; ++j) {
      if (!open_[j]) continue;
      const Eigen::Matrix3d& E = placement.rate[j];
      placement.rate_change[j] = angle_rate_change(j, placement.angles[j], E);
      // From the gradient -first E^T e and de/d(angles) = -J_l^-1(e) E; J_l^-1 = J_r^-T.
      const Eigen::Vector3d& e = placement.error[j];
      const Penalty penalty(e, knots_[k].dead_band[j], kAngleScale);
      const Eigen::Vector3d pull = E.transpose() * e;
      Eigen::Matrix3d block =
          penalty.first * (E.transpose() * right_jacobian_inverse(e).transpose() * E) +
          penalty.second * pull * pull.transpose();
      for (std::size_t b = 0; b < 3; ++b) {
        block.col(as_index(b)) -= penalty.first * placement.rate_change[j][b].transpose() * e;
      }
      for (std::size_t a = 0; a < 3; ++a) {
        for (std::size_t b = 0; b < 3; ++b) {
          const int row = freedom_of_[j][a], column = freedom_of_[j][b];
          if (row < 0 || column < 0) continue;
          // Symmetric but for rounding.
          out[static_cast<std::size_t>(row) * n + static_cast<std::size_t>(column)] +=
              0.5 * knots_[k].weight * weight_[j] *
              (block(as_index(a), as_index(b)) + block(as_index(b), as_index(a)));
        }
      }
    }
    add_task_hessian(k, out);
    // What Gauss-Newton leaves out: the curvature of the paths.
    for (std::size_t t = 0; t < kTips; ++t) {
      if (tip_weight_[t] == 0.0) continue;
      const Eigen::Vector3d& d = placement.tip_error[t];
      const Eigen::Vector3d p = d + knots_[k].tip[t];
      const Eigen::Vector3d pull =
          knots_[k].weight * tip_weight_[t] * Penalty(d, kTaskDeadBand, kPositionScale).first * d;
      for (std::size_t a = 0; a < n; ++a) {
        const std::size_t i = index(freedoms_[a].joint);
        if (!open_[i] || !moves_[i][index(tip_segment_[t])]) continue;
        for (std::size_t b = a; b < n; ++b) {  // canonical order: parents first
          const std::size_t j = index(freedoms_[b].joint);
          if (!open_[j] || !moves_[j][index(tip_segment_[t])]) continue;
          add(a, b, pull.dot(acceleration(a, b, k, p)));
        }
      }
    }
  }
  for (double& value : out) value *= factor;
  if (constraints_ == 0) return;
  // The constraints are directions of one offset, so their sum is one direction.
  Eigen::Vector3d direction = Eigen::Vector3d::Zero();
  for (std::size_t c = 0; c < kDirections; ++c) {
    const double angle = 2.0 * std::numbers::pi * static_cast<double>(c) / kDirections;
    direction += multipliers[c] * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0.0);
  }
  std::array<Eigen::Vector3d, 4> points;
  support(kLastKnot, points);
  for (std::size_t b = 0; b < n; ++b) {
    const std::size_t j = index(freedoms_[b].joint);
    if (!open_[j]) continue;
    const auto [share, centre] = moved_mass(j, kLastKnot);
    for (std::size_t a = 0; a <= b; ++a) {
      const std::size_t i = index(freedoms_[a].joint);
      if (!open_[i] || !moves_[i][j]) continue;
      Eigen::Vector3d second = share * acceleration(a, b, kLastKnot, centre);
      for (std::size_t p = 0; p < points.size(); ++p) {
        const std::size_t ankle = index(p < 2 ? Joint::kLeftAnkle : Joint::kRightAnkle);
        if (moves_[j][ankle]) second -= 0.25 * acceleration(a, b, kLastKnot, points[p]);
      }
      add(a, b, direction.dot(second));
    }
  }
}

Eigen::Vector3d CorrectionModel::mass_centre(std::size_t k) const {
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  double mass = 0.0;
  for (std::size_t s = 0; s < kJointCount; ++s) {
    const double m = skeleton_[s].mass_fraction;
    moment += m * (placement_[k].p_HB[s] + placement_[k].R_HB[s] * skeleton_[s].p_BC);
    mass += m;
  }
  return moment / mass;
}

// The segments that a joint moves turn as one body about it.
CorrectionModel::MovedMass CorrectionModel::moved_mass(std::size_t joint, std::size_t k) const {
  Eigen::Vector3d moment = Eigen::Vector3d::Zero();
  double mass = 0.0, total = 0.0;
  for (std::size_t s = 0; s < kJointCount; ++s) {
    const double m = skeleton_[s].mass_fraction;
    total += m;
    if (!moves_[joint][s]) continue;
    moment += m * (placement_[k].p_HB[s] + placement_[k].R_HB[s] * skeleton_[s].p_BC);
    mass += m;
  }
  if (!(mass > 0.0)) return {0.0, Eigen::Vector3d::Zero()};
  return {mass / total, moment / mass};
}

// Ankles and balls of both feet: a little inside the true soles.
void CorrectionModel::support(std::size_t k, std::array<Eigen::Vector3d, 4>& points) const {
  std::size_t next = 0;
  for (const Joint ankle : {Joint::kLeftAnkle, Joint::kRightAnkle}) {
    const std::size_t s = index(ankle);
    points[next++] = placement_[k].p_HB[s];
    points[next++] = placement_[k].p_HB[s] + placement_[k].R_HB[s] * skeleton_[s].p_BE;
  }
}

void CorrectionModel::balance(std::span<const double> delta, std::span<double> out) {
  if (constraints_ == 0) return;
  place(delta);
  std::array<Eigen::Vector3d, 4> points;
  support(kLastKnot, points);
  const Eigen::Vector3d offset =
      mass_centre(kLastKnot) - 0.25 * (points[0] + points[1] + points[2] + points[3]);
  for (std::size_t c = 0; c < kDirections; ++c) {
    const double angle = 2.0 * std::numbers::pi * static_cast<double>(c) / kDirections;
    out[c] = std::cos(angle) * offset.x() + std::sin(angle) * offset.y();
  }
}

void CorrectionModel::balance_jacobian(std::span<const double> delta, std::span<double> out) {
  if (constraints_ == 0) return;
  place(delta);
  std::array<Eigen::Vector3d, 4> points;
  support(kLastKnot, points);
  for (std::size_t i = 0; i < size(); ++i) {
    const std::size_t j = index(freedoms_[i].joint);
    Eigen::Vector3d velocity = Eigen::Vector3d::Zero();
    if (open_[j]) {
      const auto [share, centre] = moved_mass(j, kLastKnot);
      velocity += share * lever(i, kLastKnot, centre);
      for (std::size_t p = 0; p < points.size(); ++p) {
        const std::size_t ankle = index(p < 2 ? Joint::kLeftAnkle : Joint::kRightAnkle);
        if (moves_[j][ankle]) velocity -= 0.25 * lever(i, kLastKnot, points[p]);
      }
    }
    for (std::size_t c = 0; c < kDirections; ++c) {
      const double angle = 2.0 * std::numbers::pi * static_cast<double>(c) / kDirections;
      out[c * size() + i] = std::cos(angle) * velocity.x() + std::sin(angle) * velocity.y();
    }
  }
}

void CorrectionModel::targets(std::span<const double> delta, JointVectors& target) const {
  const auto& anatomy = canonical_anatomy();
  for (std::size_t j = 0; j < kJointCount; ++j) {
    target[j].setZero();
    if (!open_[j]) continue;
    const auto joint = static_cast<Joint>(j);
    const JointAngles& present = present_angles_[j];
    const auto corrected = [&](double part) {
      JointAngles angles = present;
      for (std::size_t movement = 0; movement < 3; ++movement) {
        const int i = freedom_of_[j][movement];
        if (i >= 0) angles[movement] += part * delta[static_cast<std::size_t>(i)];
      }
      return joint_rotation(joint, angles);
    };
    // Past a shoulder's singularity the same orientation reads as other angles, so the limits are
    // looked at again on the orientation itself.
    const auto inside = [&](const Eigen::Quaterniond& q_PB) {
      const JointAngles angles = joint_angles(joint, q_PB);
      for (std::size_t movement = 0; movement < 3; ++movement) {
        if (freedom_of_[j][movement] < 0) continue;
        const AngleRange& range = anatomy[j].range[movement];
        if (angles[movement] < std::min(range.min, present[movement]) - 1e-9) return false;
        if (angles[movement] > std::max(range.max, present[movement]) + 1e-9) return false;
      }
      return true;
    };
    double part = 1.0;
    if (!inside(corrected(1.0))) {
      double good = 0.0, bad = 1.0;
      for (int step = 0; step < 20; ++step) {
        part = 0.5 * (good + bad);
        (inside(corrected(part)) ? good : bad) = part;
      }
      part = good;
    }
    const Eigen::Vector3d v = rotation_vector(present_[j].conjugate() * corrected(part));
    if (v.norm() >= kSmallestAsked) target[j] = v;
  }
}

bool CorrectionModel::balanced(std::span<const double> delta) {
  std::array<double, kDirections> offset;
  balance(delta, offset);
  for (std::size_t c = 0; c < constraints_; ++c) {
    if (offset[c] > balance_limit_[c] + 1e-9) return false;
  }
  return true;
}

void CorrectionModel::closed_form(std::size_t count, std::span<double> delta) {
  std::fill(delta.begin(), delta.end(), 0.0);
  std::array<std::size_t, kJointCount> order;
  std::iota(order.begin(), order.end(), std::size_t{0});
  const auto excess = [&](std::size_t j) {
    return open_[j] ? weight_[j] * std::max(0.0, present_error_[j].norm() - dead_band_[j]) : 0.0;
  };
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return excess(a) > excess(b); });
  double remaining = error(delta);
  std::size_t taken = 0;
  for (const std::size_t j : order) {
    if (taken == count || excess(j) <= 0.0) return;
    // Least squares over the movements that the joint has.
    Eigen::Matrix3d E = angle_rate(j, present_angles_[j]);
    for (std::size_t movement = 0; movement < 3; ++movement) {
      if (freedom_of_[j][movement] < 0) E.col(as_index(movement)).setZero();
    }
    const double size = present_error_[j].norm();
    const Eigen::Vector3d e = present_error_[j] * ((size - dead_band_[j]) / size);
    const Eigen::Matrix3d normal = E.transpose() * E + 1e-6 * Eigen::Matrix3d::Identity();
    const Eigen::Vector3d amount = normal.ldlt().solve(E.transpose() * e);
    for (std::size_t movement = 0; movement < 3; ++movement) {
      const int i = freedom_of_[j][movement];
      if (i < 0) continue;
      const auto at = static_cast<std::size_t>(i);
      delta[at] = std::clamp(amount(as_index(movement)), lower_[at], upper_[at]);
    }
    const double then = error(delta);
    if (then < remaining && balanced(delta)) {
      remaining = then;
      ++taken;
      continue;
    }
    for (const int i : freedom_of_[j]) {
      if (i >= 0) delta[static_cast<std::size_t>(i)] = 0.0;
    }
  }
}

}  // namespace secondskin::coach
