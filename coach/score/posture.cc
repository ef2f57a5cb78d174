#include "coach/score/posture.h"

#include <algorithm>
#include <cmath>
#include <initializer_list>
#include <limits>

#include "coach/align/expert_average.h"
#include "motion/rotation.h"

namespace secondskin::coach {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// No measurement of a body is better than this, however alike the experts: the skeleton's own
// accuracy (docs/skeleton.md).
constexpr double kLeastAngleSpread = 2.0 * std::numbers::pi / 180.0;  // [rad]
constexpr double kLeastDepthSpread = 0.02;                            // [leg lengths]

constexpr std::size_t kDepthFeature = 0;

JointSet set_of(std::initializer_list<Joint> joints) {
  JointSet set;
  for (const Joint j : joints) set.set(index(j));
  return set;
}

// From the pelvis to a joint, both included.
JointSet chain_of(Joint joint) {
  JointSet set;
  for (; joint != Joint::kPelvis; joint = canonical_anatomy()[index(joint)].parent) {
    set.set(index(joint));
  }
  return set.set(index(Joint::kPelvis));
}

// The order of the features; directions are forward, to the left and up in the pelvis's heading.
struct Limb {
  Joint left, right;
  Criterion criterion;
  bool up;  // it goes round far enough for its height to say something of its own
};
constexpr std::array<Limb, 4> kLimbs{{
    {Joint::kLeftHip, Joint::kRightHip, Criterion::kLegs, false},
    {Joint::kLeftKnee, Joint::kRightKnee, Criterion::kLegs, false},
    {Joint::kLeftShoulder, Joint::kRightShoulder, Criterion::kArms, true},
    {Joint::kLeftElbow, Joint::kRightElbow, Criterion::kArms, true},
}};

// Of the left, the right and their difference.
using Names = std::array<std::array<std::string_view, 3>, 3>;
constexpr std::array<Names, 4> kLimbNames{
    {Names{{{"left_thigh_forward", "left_thigh_left", "left_thigh_up"},
            {"right_thigh_forward", "right_thigh_left", "right_thigh_up"},
            {"thighs_forward", "thighs_left", "thighs_up"}}},
     Names{{{"left_shank_forward", "left_shank_left", "left_shank_up"},
            {"right_shank_forward", "right_shank_left", "right_shank_up"},
            {"shanks_forward", "shanks_left", "shanks_up"}}},
     Names{{{"left_upper_arm_forward", "left_upper_arm_left", "left_upper_arm_up"},
            {"right_upper_arm_forward", "right_upper_arm_left", "right_upper_arm_up"},
            {"upper_arms_forward", "upper_arms_left", "upper_arms_up"}}},
     Names{{{"left_forearm_forward", "left_forearm_left", "left_forearm_up"},
            {"right_forearm_forward", "right_forearm_left", "right_forearm_up"},
            {"forearms_forward", "forearms_left", "forearms_up"}}}}};

std::array<PostureFeature, kPostureCount> make_features() {
  std::array<PostureFeature, kPostureCount> table;
  std::size_t n = 0;
  const auto own_mirror = [&](std::string_view name, Criterion criterion, JointSet own,
                              JointSet chain, double sign) {
    table[n] = {name, criterion, {own, {}}, chain, n, sign};
    ++n;
  };
  const JointSet left_leg = set_of({Joint::kLeftHip, Joint::kLeftKnee});
  const JointSet right_leg = set_of({Joint::kRightHip, Joint::kRightKnee});
  own_mirror("depth", Criterion::kDepth, left_leg,
             chain_of(Joint::kLeftKnee) | chain_of(Joint::kRightKnee), 1.0);
  table[kDepthFeature].own[1] = right_leg;
  const JointSet pelvis = set_of({Joint::kPelvis});
  const JointSet spine = set_of({Joint::kSpineLower, Joint::kSpineMiddle, Joint::kSpineUpper});
  const JointSet head = set_of({Joint::kNeck, Joint::kHead});
  own_mirror("pelvis_forward", Criterion::kTrunk, pelvis, pelvis, 1.0);
  own_mirror("pelvis_left", Criterion::kTrunk, pelvis, pelvis, -1.0);
  own_mirror("trunk_forward", Criterion::kTrunk, spine, chain_of(Joint::kSpineUpper), 1.0);
  own_mirror("trunk_left", Criterion::kTrunk, spine, chain_of(Joint::kSpineUpper), -1.0);
  own_mirror("head_forward", Criterion::kHead, head, chain_of(Joint::kHead), 1.0);
  own_mirror("head_left", Criterion::kHead, head, chain_of(Joint::kHead), -1.0);
  for (std::size_t l = 0; l < kLimbs.size(); ++l) {
    const Limb& limb = kLimbs[l];
    const std::size_t directions = limb.up ? 3 : 2;
    const JointSet left = set_of({limb.left}), right = set_of({limb.right});
    for (std::size_t d = 0; d < directions; ++d) {
      const double sign = d == 1 ? -1.0 : 1.0;
      table[n] = {kLimbNames[l][0][d], limb.criterion, {left, {}},
                  chain_of(limb.left), n + directions, sign};
      table[n + directions] = {
          kLimbNames[l][1][d], limb.criterion, {right, {}}, chain_of(limb.right), n, sign};
      // left - right: forward and up change their sign; left + right does so for "left".
      table[n + 2 * directions] = {kLimbNames[l][2][d], Criterion::kSymmetry,
                                   {left, right},       chain_of(limb.left) | chain_of(limb.right),
                                   n + 2 * directions,  -1.0};
      ++n;
    }
    n += 2 * directions;
  }
  return table;
}

double inclination(double component) noexcept {
  return std::asin(std::clamp(component, -1.0, 1.0));
}

bool known(const Pose& pose, std::size_t j) noexcept {
  return j < pose.q_PB.size() && j < pose.confidence.size() && pose.confidence[j] > 0.0F &&
         pose.q_PB[j].coeffs().allFinite();
}

// Variance of what `count` experts show, pooled with the prior. Equation 4.
double pooled(double square_sum, double count, double prior, double least) {
  const double freedom = std::max(0.0, count - 1.0);
  const double variance = (kPriorExperts * prior * prior + square_sum) / (kPriorExperts + freedom);
  return std::max(least, std::sqrt(variance));
}

Posture prior_spread(const std::array<double, kJointCount>& tolerance) {
  Posture prior;
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    const PostureFeature& feature = posture_features()[f];
    double square = 0.0;
    for (const JointSet& side : feature.own) {
      double least = std::numeric_limits<double>::infinity();
      for (std::size_t j = 0; j < kJointCount; ++j) {
        if (side[j]) least = std::min(least, 0.5 * tolerance[j]);
      }
      // A difference of two sides has both's variance.
      if (side.any()) square += least * least;
    }
    // A leg is two segments of about half its length; a level one that tilts by the spread changes
    // the height by half of it. The depth is one leg's.
    prior[f] = f == kDepthFeature ? 0.5 * std::sqrt(0.5 * square) : std::sqrt(square);
  }
  return prior;
}

}  // namespace

const std::array<PostureFeature, kPostureCount>& posture_features() noexcept {
  static const auto table = make_features();
  return table;
}

Posture posture_of(const Pose& pose, const JointSet& needed) noexcept {
  std::array<Eigen::Vector3d, kJointCount> up;  // each segment's own z in the heading's frame
  std::array<Eigen::Quaterniond, kJointCount> q_HB;
  JointSet missing;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    const bool have = known(pose, j);
    if (!have && needed[j]) missing.set(j);
    const Eigen::Quaterniond q = have ? pose.q_PB[j] : Eigen::Quaterniond::Identity();
    if (j == index(Joint::kPelvis)) {
      const double heading = twist_angle(q, Eigen::Vector3d::UnitZ());
      q_HB[j] = Eigen::AngleAxisd(-heading, Eigen::Vector3d::UnitZ()) * q;
    } else {
      q_HB[j] = q_HB[index(canonical_anatomy()[j].parent)] * q;
    }
    up[j] = q_HB[j] * Eigen::Vector3d::UnitZ();
  }

  Posture out;
  std::size_t n = 0;
  const auto height = [&](Joint hip, Joint knee) {
    return 0.5 * (up[index(hip)].z() + up[index(knee)].z());
  };
  out[n++] = std::max(height(Joint::kLeftHip, Joint::kLeftKnee),
                      height(Joint::kRightHip, Joint::kRightKnee));
  const Eigen::Vector3d trunk = (up[index(Joint::kSpineLower)] + up[index(Joint::kSpineMiddle)] +
                                 up[index(Joint::kSpineUpper)])
                                    .normalized();
  for (const Eigen::Vector3d& axis : {up[index(Joint::kPelvis)], trunk, up[index(Joint::kHead)]}) {
    out[n++] = inclination(axis.x());
    out[n++] = inclination(axis.y());
  }
  for (const Limb& limb : kLimbs) {
    const Eigen::Index directions = limb.up ? 3 : 2;
    // A limb hangs along its own -z.
    for (const Joint side : {limb.left, limb.right}) {
      for (Eigen::Index d = 0; d < directions; ++d) out[n++] = inclination(-up[index(side)][d]);
    }
    for (Eigen::Index d = 0; d < directions; ++d) {
      const std::size_t right = n - static_cast<std::size_t>(directions);
      const std::size_t left = right - static_cast<std::size_t>(directions);
      out[n] = d == 1 ? out[left] + out[right] : out[left] - out[right];
      ++n;
    }
  }
  if (missing.any()) {
    for (std::size_t f = 0; f < kPostureCount; ++f) {
      if ((posture_features()[f].chain & missing).any()) out[f] = kNaN;
    }
  }
  return out;
}

JointSet measured_joints(const Motion& motion) {
  std::array<std::size_t, kJointCount> seen{};
  for (const Pose& pose : motion.poses) {
    for (std::size_t j = 0; j < kJointCount; ++j) seen[j] += known(pose, j) ? 1 : 0;
  }
  JointSet joints;
  for (std::size_t j = 0; j < kJointCount; ++j) joints[j] = 2 * seen[j] >= motion.poses.size();
  return joints;
}

PostureModel posture_model(const Motion& mean, std::span<const Motion> experts,
                           const std::array<double, kJointCount>& weight,
                           const std::array<double, kJointCount>& tolerance) {
  PostureModel model;
  model.needed = measured_joints(mean);
  const std::size_t frames = mean.poses.size();
  const Posture prior = prior_spread(tolerance);

  // Every expert's features at the frames of the mean motion.
  std::vector<std::vector<Posture>> all;
  std::vector<Posture> ranges;
  const auto add = [&](const Motion& expert, const std::vector<double>& path) {
    std::vector<Posture> values(frames);
    Pose pose(kJointCount);
    for (std::size_t i = 0; i < frames; ++i) {
      sample(expert, path.empty() ? static_cast<double>(i) / mean.rate_hz : path[i] / mean.rate_hz,
             pose);
      values[i] = posture_of(pose, model.needed);
    }
    // The range is that of the performance itself: warping blunts the turning points.
    Posture low, high;
    low.fill(std::numeric_limits<double>::infinity());
    high.fill(-std::numeric_limits<double>::infinity());
    for (const Pose& own : expert.poses) {
      const Posture v = posture_of(own, model.needed);
      for (std::size_t f = 0; f < kPostureCount; ++f) {
        if (std::isnan(v[f])) continue;
        low[f] = std::min(low[f], v[f]);
        high[f] = std::max(high[f], v[f]);
      }
    }
    for (std::size_t f = 0; f < kPostureCount; ++f) low[f] = high[f] - low[f];
    ranges.push_back(low);
    all.push_back(std::move(values));
  };
  if (experts.size() < 2) {
    add(mean, {});
  } else {
    for (const Motion& expert : experts) {
      const Motion at_rate = resample(expert, mean.rate_hz);
      add(at_rate, warp_onto(mean, at_rate, weight));
    }
  }

  const auto statistics = [&](auto value_of, std::size_t f, double& average, double& spread) {
    double sum = 0.0, count = 0.0, square = 0.0;
    for (std::size_t e = 0; e < all.size(); ++e) {
      const double v = value_of(e);
      if (!std::isfinite(v)) continue;
      sum += v;
      count += 1.0;
    }
    average = count > 0.0 ? sum / count : kNaN;
    for (std::size_t e = 0; e < all.size(); ++e) {
      const double v = value_of(e);
      if (std::isfinite(v)) square += (v - average) * (v - average);
    }
    spread =
        pooled(square, count, prior[f], f == kDepthFeature ? kLeastDepthSpread : kLeastAngleSpread);
  };
  model.mean.resize(frames);
  model.spread.resize(frames);
  model.spread_from_start.resize(frames);
  const auto first =
      std::min(frames, static_cast<std::size_t>(std::lround(kStartTime * mean.rate_hz)) + 1);
  for (std::size_t f = 0; f < kPostureCount; ++f) {
    for (std::size_t i = 0; i < frames; ++i) {
      statistics([&](std::size_t e) { return all[e][i][f]; }, f, model.mean[i][f],
                 model.spread[i][f]);
    }
    std::vector<double> start(all.size(), 0.0);
    for (std::size_t e = 0; e < all.size(); ++e) {
      for (std::size_t i = 0; i < first; ++i) {
        start[e] += (all[e][i][f] - model.mean[i][f]) / static_cast<double>(first);
      }
    }
    double unused = 0.0;
    for (std::size_t i = 0; i < frames; ++i) {
      statistics([&](std::size_t e) { return all[e][i][f] - model.mean[i][f] - start[e]; }, f,
                 unused, model.spread_from_start[i][f]);
    }
    statistics([&](std::size_t e) { return ranges[e][f]; }, f, model.range[f],
               model.range_spread[f]);
  }
  return model;
}

PostureModel stretched(const PostureModel& model, std::size_t frames) {
  PostureModel result = model;
  if (model.empty()) return result;
  const auto stretch = [frames](const std::vector<Posture>& from) {
    std::vector<Posture> to(frames);
    const auto last = static_cast<double>(from.size() - 1);
    for (std::size_t i = 0; i < frames; ++i) {
      const double at =
          frames == 1 ? 0.0 : last * static_cast<double>(i) / static_cast<double>(frames - 1);
      const auto before = static_cast<std::size_t>(at);
      const std::size_t after = std::min(before + 1, from.size() - 1);
      const double u = at - static_cast<double>(before);
      for (std::size_t f = 0; f < kPostureCount; ++f) {
        to[i][f] = (1.0 - u) * from[before][f] + u * from[after][f];
      }
    }
    return to;
  };
  result.mean = stretch(model.mean);
  result.spread = stretch(model.spread);
  result.spread_from_start = stretch(model.spread_from_start);
  return result;
}

PostureModel mirrored(const PostureModel& model) {
  PostureModel result = model;
  for (std::size_t j = 0; j < kJointCount; ++j) {
    result.needed[j] = model.needed[index(secondskin::mirrored(static_cast<Joint>(j)))];
  }
  const auto exchange = [](const Posture& from, bool is_signed) {
    Posture to;
    for (std::size_t f = 0; f < kPostureCount; ++f) {
      const PostureFeature& feature = posture_features()[f];
      to[f] = (is_signed ? feature.mirrored_sign : 1.0) * from[feature.mirrored];
    }
    return to;
  };
  for (Posture& p : result.mean) p = exchange(p, true);
  for (Posture& p : result.spread) p = exchange(p, false);
  for (Posture& p : result.spread_from_start) p = exchange(p, false);
  result.range = exchange(model.range, false);
  result.range_spread = exchange(model.range_spread, false);
  return result;
}

}  // namespace secondskin::coach
