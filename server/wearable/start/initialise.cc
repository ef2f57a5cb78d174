#include "server/wearable/start/initialise.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>
#include <stdexcept>

#include "motion/kinematics.h"

namespace secondskin::server {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kOddTilt = 25.0 * kDegree;   // gravity this far off: not worn so
constexpr double kOddGravity = 0.6;           // [m/s^2]
constexpr double kOddOffset = 3.0 * kDegree;  // of a gyroscope [rad/s]
constexpr double kOddDistance = 0.04;         // [m]
constexpr double kFixedBones = 1e-4;          // as good as exact, and no trouble to the solver
constexpr double kMeasuredBody = 0.01;        // of its bones, relative
constexpr double kHeadingKnown = 0.05;        // of a board that sits as its file says [rad]
constexpr double kOffsetFloor = 0.0005;       // what a gyroscope's offset keeps wandering

Rest reordered(const Rest& rest, const std::vector<std::size_t>& channel) {
  Rest out = rest;
  for (std::size_t b = 0; b < channel.size(); ++b) {
    out.boards[b] = rest.boards[channel[b]];
    const auto to = static_cast<Eigen::Index>(b), from = static_cast<Eigen::Index>(channel[b]);
    out.distances.col(to) = rest.distances.col(from);
    out.heard.col(to) = rest.heard.col(from);
  }
  return out;
}

void look_at_boards(const Garment& garment, const Rest& rest, std::vector<std::string>& warnings) {
  for (std::size_t b = 0; b < garment.boards.size(); ++b) {
    const std::string& name = garment.boards[b].name;
    const BoardRest& board = rest.boards[b];
    if (board.gyro_readings + board.accel_readings == 0) {
      warnings.push_back(fmt::format("{}: silent", name));
      continue;
    }
    if (board.accel_readings > 0 && std::abs(board.accel.norm() - kStandardGravity) > kOddGravity) {
      warnings.push_back(fmt::format(
          "{}: feels {:.2f} m/s^2 at rest instead of {:.2f}: calibrate its accelerometer", name,
          board.accel.norm(), kStandardGravity));
    }
    if (board.gyro.norm() > kOddOffset) {
      warnings.push_back(fmt::format("{}: gyroscope's offset is {:.1f} degrees/s", name,
                                     board.gyro.norm() / kDegree));
    }
  }
}

}  // namespace

Skeleton body_of(const StartSettings& settings) {
  return settings.body ? *settings.body : wearer_skeleton(settings.wearer);
}

void stand_on_floor(const Skeleton& canonical, Pose& pose) {
  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(canonical, pose.p_WR, pose.q_PB, X_WB);
  double lowest = std::numeric_limits<double>::infinity();
  for (const Joint foot : {Joint::kLeftToes, Joint::kRightToes}) {
    lowest = std::min(lowest, X_WB[index(foot)].translation().z() - ball_height(canonical, foot));
  }
  pose.p_WR.z() -= lowest;
}

StartResult initialise(const Garment& garment, const StartSettings& settings, const Rest& felt,
                       const Movement* movement) {
  const std::size_t boards = garment.boards.size();
  const Skeleton body = body_of(settings);
  Pose asked = settings.pose;
  stand_on_floor(body, asked);
  std::vector<Eigen::Isometry3d> X_BS = nominal_places(body, garment);
  std::vector<bool> known(boards, true);
  for (std::size_t b = 0; b < settings.mountings.size() && b < boards; ++b) {
    known[b] = settings.mountings[b].has_value();
    if (known[b]) X_BS[b].linear() = settings.mountings[b]->toRotationMatrix();
  }

  std::vector<std::size_t> channel(boards);
  std::iota(channel.begin(), channel.end(), std::size_t{0});
  std::vector<std::string> warnings;
  const bool all_known = std::all_of(known.begin(), known.end(), [](bool is) { return is; });
  std::vector<Swap> swapped;
  if (all_known) swapped = swapped_at_rest(body, garment, asked, X_BS, felt);
  for (const Swap& swap : swapped) {
    std::swap(channel[swap.left], channel[swap.right]);
    warnings.push_back(fmt::format("{} and {} are swapped: each is taken as the other",
                                   garment.boards[swap.left].name,
                                   garment.boards[swap.right].name));
  }
  std::optional<Movement> moved;
  if (movement != nullptr) {
    moved = *movement;
    moved->reorder(channel);
    for (const Swap& swap : swapped_by_movement(garment, *moved)) {
      swapped.push_back(swap);
      warnings.push_back(
          fmt::format("{} and {} move as if they were swapped: look whether they are",
                      garment.boards[swap.left].name, garment.boards[swap.right].name));
    }
  }
  const Rest rest = reordered(felt, channel);
  look_at_boards(garment, rest, warnings);

  StartResult result{
      body, asked, rest.end_ns, {}, {}, {}, {}, swapped, channel, {body, {}, {}, {}, {}}, 0.0, {}};
  auto bones = bone_sigmas(settings.wearer);
  if (settings.body) bones.fill(kMeasuredBody);
  if (!settings.refine_bones) bones.fill(kFixedBones);
  result.fit = fit_rest(body, bones, garment, asked, X_BS, known, rest, settings.fit);
  result.skeleton = result.fit.skeleton;
  result.pose = result.fit.pose;
  stand_on_floor(result.skeleton, result.pose);
  result.X_BS = result.fit.X_BS;
  result.rest = 1e-9 * static_cast<double>(rest.end_ns - rest.begin_ns);

  std::vector<Eigen::Isometry3d> X_WB(kJointCount);
  forward_kinematics(body, asked.p_WR, asked.q_PB, X_WB);
  for (std::size_t b = 0; b < boards; ++b) {
    if (!known[b] || rest.boards[b].accel_readings == 0) continue;
    const Eigen::Vector3d up_W = X_WB[index(garment.boards[b].segment)].linear() *
                                 X_BS[b].linear() * rest.boards[b].accel.normalized();
    const double tilt = std::acos(std::clamp(up_W.z(), -1.0, 1.0));
    if (tilt > kOddTilt) {
      warnings.push_back(fmt::format(
          "{}: is tilted by {:.0f} degrees against where it should sit: is it turned, or "
          "on another limb?",
          garment.boards[b].name, tilt / kDegree));
    }
  }
  if (result.fit.distance > kOddDistance) {
    warnings.push_back(fmt::format(
        "distances at rest are off by {:.0f} mm: is the pose as asked, the stature right?",
        1e3 * result.fit.distance));
  }

  if (moved) {
    std::vector<double> sure(boards);
    for (std::size_t b = 0; b < boards; ++b) {
      sure[b] = known[b] ? kHeadingKnown : std::numeric_limits<double>::infinity();
    }
    result.headings =
        functional_headings(result.skeleton, garment, result.pose, result.X_BS, *moved, sure);
    for (std::size_t b = 0; b < boards; ++b) {
      const BoardHeading& heading = result.headings[b];
      if (!heading.found) {
        if (!known[b]) {
          warnings.push_back(
              fmt::format("{}: its heading is not known; bend that joint forward and "
                          "back a few times after standing still",
                          garment.boards[b].name));
        }
        continue;
      }
      turn_about_vertical(result.skeleton, garment.boards[b], result.pose, heading.turn,
                          result.X_BS[b]);
    }
  }

  for (std::size_t b = 0; b < boards; ++b) {
    BoardBias bias;
    const BoardRest& board = rest.boards[b];
    if (board.gyro_readings > 0) {
      bias.gyro = board.gyro;
      const double blocks = std::max(1.0, 10.0 * result.rest);
      bias.gyro_sigma = std::hypot(kOffsetFloor, board.gyro_deviation / std::sqrt(blocks));
    }
    // Of an accelerometer only the part along gravity shows at rest.
    if (board.accel_readings > 0 && std::abs(board.accel.norm() - kStandardGravity) < kOddGravity) {
      bias.accel = board.accel - kStandardGravity * board.accel.normalized();
    }
    result.biases.push_back(bias);
    result.fields_S.push_back(board.magnetic_readings > 0 ? std::optional(board.magnetic)
                                                          : std::nullopt);
  }
  result.warnings = std::move(warnings);
  return result;
}

Starter::Starter(const Garment& garment, StartSettings settings)
    : garment_(garment), settings_(std::move(settings)), finder_(garment, settings_.rest) {}

Starter::Stage Starter::add(const Measurement& measurement) {
  switch (stage_) {
    case Stage::kWaitingForRest:
      if (!finder_.add(measurement)) break;
      rest_ = finder_.rest();
      movement_.emplace(garment_, *rest_);
      stage_ = settings_.movement > 0.0 ? Stage::kMoving : Stage::kDone;
      break;
    case Stage::kMoving:
      movement_->add(measurement);
      if (movement_->duration() >= settings_.movement) stage_ = Stage::kDone;
      break;
    case Stage::kDone:
      break;
  }
  return stage_;
}

StartResult Starter::finish() const {
  const auto rest = rest_ ? rest_ : finder_.rest();
  if (!rest) {
    throw std::runtime_error(fmt::format(
        "the wearer never stood still for {:g} s: begin in the rest pose, upright, arms "
        "hanging, palms to the thighs",
        settings_.rest.shortest));
  }
  return initialise(garment_, settings_, *rest,
                    movement_ && movement_->size() > 0 ? &*movement_ : nullptr);
}

}  // namespace secondskin::server
