#include "sim/optical/virtual_rig.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <stdexcept>

#include "wire/photo_tag.h"

namespace secondskin::sim {
namespace {

constexpr double kCounts = 256.0;
constexpr double kFoot = 0.3048;
constexpr double kCircleRadius = 11.0 * kFoot;  // 2.3: 22 feet in diameter
constexpr std::size_t kPairs = 8;               // 2.3: sixteen projectors

// A point on a projector's mask, -1 to 1 across the field: `across` the stripes and along them.
struct MaskPoint {
  double across;
  double along;
  bool inside() const noexcept { return std::abs(across) <= 1.0 && std::abs(along) <= 1.0; }
  double coordinate() const noexcept { return 0.5 * kCounts * (1.0 + across); }
};

// Empty behind the projector and out of its range.
std::optional<MaskPoint> project(const VirtualProjector& projector,
                                 const Eigen::Vector3d& p_W) noexcept {
  const Eigen::Vector3d p_J =
      projector.X_WJ.linear().transpose() * (p_W - projector.X_WJ.translation());
  const double distance = p_J.norm();
  if (!(p_J.z() > 0.0) || distance < projector.nearest || distance > projector.farthest) {
    return std::nullopt;
  }
  const double edge = p_J.z() * std::tan(0.5 * projector.field);
  return MaskPoint{p_J.x() / edge, p_J.y() / edge};
}

// The probability that of `pulses` carrier pulses, each received with probability p, fewer than
// `needed` are.
double missing_probability(int pulses, int needed, double p) noexcept {
  double term = std::pow(1.0 - p, pulses);
  double sum = 0.0;
  for (int k = 0; k < needed; ++k) {
    sum += term;
    term *= static_cast<double>(pulses - k) / (k + 1) * p / (1.0 - p);
  }
  return std::min(sum, 1.0);
}

// What is lost at the edge of a detector's view: of the carrier's pulses a share arrives that
// falls to none over the grazing zone; a bit needs ten of fifteen (2.1.3), the sync bit as many as
// last for 90 of its 100 us (2.1.2).
class GrazingLoss {
 public:
  GrazingLoss() noexcept {
    constexpr int kBitPulses = static_cast<int>(wire::kCarrierHz * 1e-9 * wire::kBitOnNs + 0.5);
    constexpr int kSyncPulses = static_cast<int>(wire::kCarrierHz * 1e-9 * wire::kSyncOnNs);
    constexpr int kSyncNeeded = static_cast<int>(wire::kCarrierHz * 1e-9 * wire::kSyncSeenNs) + 1;
    static_assert(kBitPulses == 15);
    for (int i = 0; i <= kSteps; ++i) {
      const double p = std::clamp(1.0 - static_cast<double>(i) / kSteps, 1e-9, 1.0 - 1e-9);
      bit_[i] = missing_probability(kBitPulses, wire::kPulsesToBeSeen, p);
      sync_[i] = missing_probability(kSyncPulses, kSyncNeeded, p);
    }
  }
  /// @param depth  0 where the grazing zone begins, 1 at the edge of the view
  double bit(double depth) const noexcept { return bit_[index(depth)]; }
  double sync(double depth) const noexcept { return sync_[index(depth)]; }

 private:
  static constexpr int kSteps = 256;
  static std::size_t index(double depth) noexcept {
    return static_cast<std::size_t>(std::clamp(depth, 0.0, 1.0) * kSteps);
  }
  std::array<double, kSteps + 1> bit_;
  std::array<double, kSteps + 1> sync_;
};

const GrazingLoss& grazing_loss() noexcept {
  static const GrazingLoss loss;
  return loss;
}

// How deep in its grazing zone a detector sees a projector: 0 or less in clear view, empty outside
// the view.
std::optional<double> grazing_depth(const OpticalNoise& noise, const DetectorState& detector,
                                    const Eigen::Vector3d& p_WJ) noexcept {
  if (detector.n_W.isZero(0.0)) return 0.0;
  const Eigen::Vector3d to_projector = p_WJ - detector.p_W;
  const double cosine = detector.n_W.dot(to_projector) / to_projector.norm();
  if (!(cosine > std::cos(noise.view))) return std::nullopt;
  if (noise.grazing <= 0.0 || cosine >= std::cos(noise.view - noise.grazing)) return 0.0;
  return 1.0 - (noise.view - std::acos(std::min(cosine, 1.0))) / noise.grazing;
}

}  // namespace

std::optional<double> VirtualProjector::coordinate(const Eigen::Vector3d& p_W) const noexcept {
  const auto point = project(*this, p_W);
  if (!point || !point->inside()) return std::nullopt;
  return point->coordinate();
}

Eigen::Matrix<double, 2, 4> VirtualProjector::matrix() const noexcept {
  // h is z_J, h v = (counts / 2) (z_J + x_J / tan(field / 2)) - h / 2.
  const Eigen::Isometry3d X_JW = X_WJ.inverse();
  const Eigen::RowVector4d x = X_JW.matrix().row(0);
  const Eigen::RowVector4d z = X_JW.matrix().row(2);
  Eigen::Matrix<double, 2, 4> P;
  P.row(0) = 0.5 * kCounts / std::tan(0.5 * field) * x + 0.5 * (kCounts - 1.0) * z;
  P.row(1) = z;
  return P / z[3];
}

std::vector<VirtualProjector> second_skin_rig() {
  // Level, the field at the circle's middle is 1.80 m high, hardly the volume's 6 feet. Lower than
  // half of these, so that feet are lit on the near side too; rolling the pairs by 45 degrees,
  // mounting them higher or alternately high and low sees hardly more of a moving suit
  // (docs/optical-hardware.md).
  constexpr double kHeight = 0.85;
  std::vector<VirtualProjector> rig;
  for (std::size_t pair = 0; pair < kPairs; ++pair) {
    const double azimuth = 2.0 * std::numbers::pi * static_cast<double>(pair) / kPairs;
    const Eigen::Vector3d outward(std::cos(azimuth), std::sin(azimuth), 0.0);
    const Eigen::Vector3d up = Eigen::Vector3d::UnitZ();
    VirtualProjector projector;
    projector.X_WJ.translation() = kCircleRadius * outward + kHeight * up;
    projector.X_WJ.linear() << up.cross(outward), -up, -outward;
    for (const double roll : {0.0, -0.5 * std::numbers::pi}) {
      VirtualProjector& added = rig.emplace_back(projector);
      added.X_WJ.rotate(Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ()));
    }
  }
  return rig;
}

VirtualRig::VirtualRig(std::vector<VirtualProjector> projectors, OpticalScene& scene,
                       const OpticalNoise& noise, std::uint64_t seed)
    : projectors_(std::move(projectors)),
      scene_(scene),
      noise_(noise),
      random_(seed),
      states_(scene.detectors()),
      next_(scene.detectors()),
      synced_(scene.detectors()) {
  if (projectors_.empty() || projectors_.size() > 255) {
    throw std::invalid_argument("virtual rig: expected 1 to 255 projectors, found " +
                                std::to_string(projectors_.size()));
  }
}

void VirtualRig::cycle(double time, std::span<std::uint8_t> values) {
  const std::size_t slots = projectors_.size();
  assert(values.size() == states_.size() * slots);
  scene_.at(time, states_);
  // The sync bit comes from all projectors at once: a detector needs any one of them.
  for (std::size_t i = 0; i < states_.size(); ++i) synced_[i] = sees_sync(i) ? 1 : 0;
  // Within a slot, 1 ms, a body moves on a straight line to some micrometres.
  for (std::size_t slot = 0; slot < slots; ++slot) {
    scene_.at(time + 1e-9 * static_cast<double>(wire::cycle_ns(slot + 1)), next_);
    for (std::size_t i = 0; i < states_.size(); ++i) {
      std::uint8_t& value = values[i * slots + slot];
      value = synced_[i] ? receive(projectors_[slot], slot, i) : wire::kNoValue;
    }
    std::swap(states_, next_);
  }
}

bool VirtualRig::sees_sync(std::size_t detector) {
  const DetectorState& state = states_[detector];
  const bool dropped = noise_.dropped_sync > 0.0 && uniform_(random_) < noise_.dropped_sync;
  if (dropped) return false;
  for (const VirtualProjector& projector : projectors_) {
    if (projector.dark || !projector.coordinate(state.p_W)) continue;
    const Eigen::Vector3d p_WJ = projector.X_WJ.translation();
    const auto depth = grazing_depth(noise_, state, p_WJ);
    if (!depth || scene_.hidden(detector, p_WJ)) continue;
    if (*depth <= 0.0 || uniform_(random_) >= grazing_loss().sync(*depth)) return true;
  }
  return false;
}

std::uint8_t VirtualRig::receive(const VirtualProjector& projector, std::size_t slot,
                                 std::size_t detector) {
  if (projector.dark) return wire::kNoValue;
  const Eigen::Vector3d p_WJ = projector.X_WJ.translation();
  const auto begin = project(projector, states_[detector].p_W);
  const auto end = project(projector, next_[detector].p_W);
  if (!begin || !end || (!begin->inside() && !end->inside())) return wire::kNoValue;
  const auto depth = grazing_depth(noise_, states_[detector], p_WJ);
  if (!depth || scene_.hidden(detector, p_WJ)) return wire::kNoValue;

  const double bit_loss = *depth > 0.0 ? grazing_loss().bit(*depth) : 0.0;
  std::uint8_t gray = 0;
  for (int bit = 0; bit < wire::kBits; ++bit) {
    const std::int64_t middle_ns =
        wire::bit_start_ns(slot, bit) + wire::kBitOnNs / 2 - wire::cycle_ns(slot);
    const double u = static_cast<double>(middle_ns) / wire::kSlotNs;
    const MaskPoint point{begin->across + u * (end->across - begin->across),
                          begin->along + u * (end->along - begin->along)};
    if (!point.inside()) continue;
    double edge_error = noise_.count_sigma > 0.0 ? noise_.count_sigma * normal_(random_) : 0.0;
    if (projector.mask_tilt > 0.0) {
      edge_error += projector.mask_tilt * (2.0 * uniform_(random_) - 1.0);
    }
    const double stripe = std::clamp(point.coordinate() + edge_error, 0.0, kCounts - 1.0);
    const unsigned code = wire::to_gray(static_cast<std::uint8_t>(stripe));
    const unsigned mask = 1U << (wire::kBits - 1 - bit);
    const bool clear = (code & mask) != 0;
    if (clear && (bit_loss <= 0.0 || uniform_(random_) >= bit_loss)) {
      gray = static_cast<std::uint8_t>(gray | mask);
    }
  }
  std::uint8_t value = wire::from_gray(gray);
  if (noise_.wild_share > 0.0 && uniform_(random_) < noise_.wild_share) {
    value = static_cast<std::uint8_t>(1.0 + 254.0 * uniform_(random_));
  }
  // 0 and 255 cannot be sent as values (2.1.3).
  return value == wire::kSetStart ? wire::kNoValue : value;
}

}  // namespace secondskin::sim
