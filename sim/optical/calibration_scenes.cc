#include "sim/optical/calibration_scenes.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <random>
#include <stdexcept>

namespace secondskin::sim {
namespace {

constexpr double kFoot = 0.3048;
constexpr double kGridSide = 4.0 * kFoot;  // 2.2.2

// Where the wand's middle goes: its ends reach the rest of the 6.5 x 6 foot cylinder (2.3).
constexpr double kWandRadius = 0.8;
constexpr double kWandLow = 0.35;
constexpr double kWandHigh = 1.6;

double smooth_step(double u) noexcept {
  u = std::clamp(u, 0.0, 1.0);
  return u * u * (3.0 - 2.0 * u);
}

}  // namespace

GridScene::GridScene(double height, double turn) : turn_(turn) {
  for (int row = 0; row < 3; ++row) {
    for (int column = 0; column < 4; ++column) {
      positions_.emplace_back(kGridSide * (column / 3.0 - 0.5), kGridSide * (row / 2.0 - 0.5),
                              height);
    }
  }
}

void GridScene::at(double time, std::span<DetectorState> states) {
  assert(states.size() == positions_.size());
  const double angle = 2.0 * std::numbers::pi * time / turn_;
  const Eigen::Vector3d n_W(std::cos(angle), std::sin(angle), 0.0);
  for (std::size_t i = 0; i < positions_.size(); ++i) states[i] = {positions_[i], n_W};
}

WandScene::WandScene(WandOptions options, std::uint64_t seed) : options_(std::move(options)) {
  if (options_.p_TD.size() < 2) {
    throw std::invalid_argument("wand scene: expected at least two detectors");
  }
  constexpr double kSlowest = 0.05, kFastest = 0.3;  // [Hz]
  std::mt19937_64 random(seed);
  std::uniform_real_distribution<double> uniform;
  for (Wave& wave : waves_) {
    for (Wave::Sine& sine : wave.sines) {
      sine.omega = 2.0 * std::numbers::pi * (kSlowest + (kFastest - kSlowest) * uniform(random));
      sine.phase = 2.0 * std::numbers::pi * uniform(random);
    }
  }
}

double WandScene::Wave::operator()(double time) const noexcept {
  // The sum is about normal; its distribution function makes it even.
  double sum = 0.0;
  for (const Sine& sine : sines) sum += std::sin(sine.omega * time + sine.phase);
  return std::erf(sum / std::sqrt(static_cast<double>(sines.size())));
}

Eigen::Isometry3d WandScene::waved(double time) const noexcept {
  const auto wave = [&](std::size_t i) { return waves_[i](time); };
  // A square onto a disc.
  const double x = wave(0), y = wave(1);
  const Eigen::Vector3d p_WM(kWandRadius * x * std::sqrt(1.0 - 0.5 * y * y),
                             kWandRadius * y * std::sqrt(1.0 - 0.5 * x * x),
                             0.5 * (kWandHigh + kWandLow) + 0.5 * (kWandHigh - kWandLow) * wave(2));
  const double pi = std::numbers::pi;
  const Eigen::Quaterniond q_WT = Eigen::AngleAxisd(pi * wave(3), Eigen::Vector3d::UnitZ()) *
                                  Eigen::AngleAxisd(0.5 * pi * wave(4), Eigen::Vector3d::UnitY()) *
                                  Eigen::AngleAxisd(pi * wave(5), Eigen::Vector3d::UnitX());
  Eigen::Vector3d p_TM = Eigen::Vector3d::Zero();
  for (const Eigen::Vector3d& p_TD : options_.p_TD) {
    p_TM += p_TD / static_cast<double>(options_.p_TD.size());
  }
  Eigen::Isometry3d X_WT = Eigen::Isometry3d::Identity();
  X_WT.linear() = q_WT.toRotationMatrix();
  X_WT.translation() = p_WM - q_WT * p_TM;
  return X_WT;
}

void WandScene::at(double time, std::span<DetectorState> states) {
  assert(states.size() == options_.p_TD.size());
  Eigen::Isometry3d X_WT = waved(time);
  if (time > options_.wave) {
    const double u =
        options_.lay_down > 0.0 ? smooth_step((time - options_.wave) / options_.lay_down) : 1.0;
    const Eigen::Quaterniond q_WT(X_WT.linear());
    X_WT.linear() = q_WT.slerp(u, Eigen::Quaterniond::Identity()).toRotationMatrix();
    X_WT.translation() =
        (1.0 - u) * X_WT.translation() + u * options_.rest_height * Eigen::Vector3d::UnitZ();
  }
  for (std::size_t i = 0; i < options_.p_TD.size(); ++i) {
    states[i] = {X_WT * options_.p_TD[i], Eigen::Vector3d::Zero()};
  }
}

TongsScene::TongsScene(SuitScene& body, Joint joint, double gap)
    : body_(body), joint_(joint), reach_(segment_capsule(body.skeleton(), joint).radius + gap) {}

void TongsScene::at(double time, std::span<DetectorState> states) {
  assert(states.size() == detectors());
  body_.at(time, states.first(body_.detectors()));
  const Eigen::Isometry3d& X_WB = body_.segments()[index(joint_)];
  // Across the joint, from its left and its right.
  const Eigen::Vector3d across = X_WB.linear().col(1);
  for (std::size_t i = 0; i < 2; ++i) {
    const double side = i == 0 ? 1.0 : -1.0;
    states[body_.detectors() + i] = {X_WB.translation() + side * reach_ * across,
                                     Eigen::Vector3d::Zero()};
  }
}

bool TongsScene::hidden(std::size_t detector, const Eigen::Vector3d& p_W) const {
  if (detector < body_.detectors()) return body_.hidden(detector, p_W);
  return false;
}

}  // namespace secondskin::sim
