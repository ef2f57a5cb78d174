#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "server/wearable/estimate/body_filter.h"

/// Foot contacts (Practical Motion Capture, section 6): a foot whose board neither turns nor is
/// pushed stands on the ground; then a point of it does not move, and is as high as the floor.
///
/// That bounds the root's drift over the ground to what a step adds. What stays unobservable
/// without an absolute measurement: where on the floor and in which heading the wearer began (both
/// taken as 0), and slowly the heading, as a foot that stands still says nothing about its
/// gyroscope's turn about the vertical beyond its offset.
namespace secondskin::server {

struct ContactSettings {
  double window = 0.03;   ///< readings are averaged over this: rounding, impact ringing [s]
  double lasting = 0.05;  ///< stillness this long is a contact [s]
  double rate_on = 0.7, rate_off = 1.2;    ///< of the board [rad/s]
  double force_on = 1.2, force_off = 2.5;  ///< | |accel| - g | [m/s^2]
  double velocity = 0.1;                   ///< of a standing foot's point: it rolls and slips [m/s]
  double every = 0.1;    ///< between two observations of one foot: their errors last [s]
  bool floor = true;     ///< the ground is level: z = 0 wherever a foot stands
  double height = 0.05;  ///< of the floor and the sole [m]
};

struct ContactCounts {
  std::uint64_t contacts = 0;           ///< times that a foot came to stand
  std::uint64_t used = 0, refused = 0;  ///< velocities and heights
};

/// A board on something that stands at times, and the point of it that then does not move.
struct StandingPoint {
  std::size_t board, segment;
  Eigen::Vector3d p_BQ;
  double height;  ///< of that point while it stands [m]
};

class FootContacts {
 public:
  /// Uses the boards on feet (ankle segments); without any it does nothing.
  FootContacts(const Skeleton& canonical, const Garment& garment,
               const ContactSettings& settings = {});

  FootContacts(const std::vector<StandingPoint>& points, const ContactSettings& settings = {});

  /// Looks at an inertial measurement that the filter has processed, and tells the filter what it
  /// follows from feet that stand.
  void update(const Measurement& measurement, BodyFilter& filter) noexcept;

  /// The wearer stands with all feet on the floor, as the filter has it now: the height at which a
  /// foot stands is its own, so that legs which are not quite as long as assumed do not tilt the
  /// body.
  void stand_here(const BodyFilter& filter) noexcept;

  std::size_t feet() const noexcept { return feet_.size(); }
  bool stands(std::size_t foot) const noexcept { return feet_[foot].stands; }
  std::size_t segment(std::size_t foot) const noexcept { return feet_[foot].point.segment; }
  const ContactCounts& counts() const noexcept { return counts_; }

 private:
  struct Foot {
    StandingPoint point;
    Eigen::Vector3d rate = Eigen::Vector3d::Zero();  // averaged
    double force = 0.0;
    bool stands = false;
    double still = 0.0;  // for how long
    std::int64_t seen_ns = 0, told_ns = 0;
  };
  ContactSettings settings_;
  std::vector<Foot> feet_;
  ContactCounts counts_;
};

}  // namespace secondskin::server
