#include "server/wearable/root/foot_contacts.h"

#include <algorithm>
#include <cmath>

namespace secondskin::server {
namespace {

// The balls of the feet: what leaves the ground last.
std::vector<StandingPoint> feet_of(const Skeleton& canonical, const Garment& garment) {
  std::vector<StandingPoint> points;
  for (const auto& [ankle, toes] : {std::pair{Joint::kLeftAnkle, Joint::kLeftToes},
                                    std::pair{Joint::kRightAnkle, Joint::kRightToes}}) {
    for (std::size_t b = 0; b < garment.boards.size(); ++b) {
      if (garment.boards[b].segment != ankle) continue;
      const Eigen::Vector3d p_BQ = canonical[index(toes)].p_PB;
      points.push_back({b, index(ankle), p_BQ, ball_height(canonical, toes)});
      break;
    }
  }
  return points;
}

}  // namespace

FootContacts::FootContacts(const std::vector<StandingPoint>& points,
                           const ContactSettings& settings)
    : settings_(settings) {
  for (const StandingPoint& point : points) {
    feet_.emplace_back();
    feet_.back().point = point;
  }
}

FootContacts::FootContacts(const Skeleton& canonical, const Garment& garment,
                           const ContactSettings& settings)
    : FootContacts(feet_of(canonical, garment), settings) {}

void FootContacts::stand_here(const BodyFilter& filter) noexcept {
  for (Foot& foot : feet_) {
    foot.point.height = filter.point_position(foot.point.segment, foot.point.p_BQ).z();
  }
}

void FootContacts::update(const Measurement& measurement, BodyFilter& filter) noexcept {
  if (measurement.kind != MeasurementKind::kInertial) return;
  for (Foot& foot : feet_) {
    if (foot.point.board >= measurement.boards.size()) continue;
    const BoardReading& reading = measurement.boards[foot.point.board];
    const double dt =
        std::clamp(1e-9 * static_cast<double>(measurement.stamp_ns - foot.seen_ns), 0.0, 1.0);
    // A reading that is missing is no stillness: saturation is what a stamp on the ground does.
    if (!reading.gyro_valid || !reading.accel_valid) {
      foot.stands = false;
      foot.still = 0.0;
      continue;
    }
    foot.seen_ns = measurement.stamp_ns;
    const double gain = dt / (settings_.window + dt);
    // An impact counts as movement, however hard, not as a long one.
    const double most_rate = 3.0 * settings_.rate_off, most_force = 3.0 * settings_.force_off;
    Eigen::Vector3d rate_now = reading.gyro - filter.bias(foot.point.board).gyro;
    rate_now *= std::min(1.0, most_rate / std::max(1e-9, rate_now.norm()));
    const double force_now =
        std::clamp(reading.accel.norm() - kStandardGravity, -most_force, most_force);
    foot.rate += gain * (rate_now - foot.rate);
    foot.force += gain * (force_now - foot.force);
    const double rate = foot.rate.norm(), force = std::abs(foot.force);
    const bool still = rate < settings_.rate_on && force < settings_.force_on;
    foot.still = still ? foot.still + dt : 0.0;
    if (!foot.stands && foot.still >= settings_.lasting) {
      foot.stands = true;
      ++counts_.contacts;
    }
    if (rate > settings_.rate_off || force > settings_.force_off) foot.stands = false;
    const double since = 1e-9 * static_cast<double>(measurement.stamp_ns - foot.told_ns);
    if (!foot.stands || (since >= 0.0 && since < settings_.every)) continue;
    foot.told_ns = measurement.stamp_ns;
    const bool rests =
        filter.observe_point_velocity(measurement.stamp_ns, foot.point.segment, foot.point.p_BQ,
                                      Eigen::Vector3d::Zero(), settings_.velocity);
    ++(rests ? counts_.used : counts_.refused);
    if (!settings_.floor) continue;
    const bool level =
        filter.observe_point_height(measurement.stamp_ns, foot.point.segment, foot.point.p_BQ,
                                    foot.point.height, settings_.height);
    ++(level ? counts_.used : counts_.refused);
  }
}

}  // namespace secondskin::server
