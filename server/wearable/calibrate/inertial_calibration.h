#pragma once

#include <span>
#include <string>
#include <tl/expected.hpp>

#include "server/wearable/calibrate/steady_parts.h"
#include "server/wearable/signal/wearable_calibration.h"

/// Zero crossings and slopes of one board's gyroscopes and accelerometers (Practical Motion
/// Capture, 4.3), and easier ways to them.
namespace secondskin::server {

/// Why a calibration is not given out, for the user: what is missing, and what to do.
struct WearableRefusal {
  std::string text;
};

/// What three axes of a sensor came out as.
struct AxesFit {
  Eigen::Vector3d zero;   ///< [code]
  Eigen::Vector3d slope;  ///< [unit a code]
  std::size_t parts = 0;  ///< steady parts that were used
  double residual = 0.0;  ///< RMS of what the parts leave [unit]; 0 where nothing is left over
};

/// Fewer poses than this leave the accelerometer's six numbers too uncertain.
inline constexpr std::size_t kLeastPoses = 9;

/// The paper's: each axis aligned with gravity and against it, to a level's accuracy. The zero is
/// the mean of the two, the slope 2 g over their difference. Parts that are upright to 12 degrees
/// by the board's nominal values count. Refused naming the axes and directions that are missing.
tl::expected<AxesFit, WearableRefusal> accelerometer_by_axes(std::span<const SteadyPart> parts,
                                                             const BoardCalibration& nominal);

/// Still poses in any orientation: least squares of |slope * (code - zero)| = g. Refused with fewer
/// than nine poses that differ by 15 degrees, and when an axis pointed never up or never down (half
/// of g at least).
tl::expected<AxesFit, WearableRefusal> accelerometer_by_poses(std::span<const SteadyPart> parts,
                                                              const BoardCalibration& nominal);

/// The paper's: a turntable, with each axis up and down. The zero is the mean of the two, the slope
/// twice the rate over their difference. Refused naming the axes and directions that are missing.
/// @param rate  of the turntable [rad/s]; 45 rpm are 4.712
tl::expected<AxesFit, WearableRefusal> gyroscope_by_turntable(std::span<const SteadyPart> parts,
                                                              const BoardCalibration& nominal,
                                                              double rate);

/// Zero crossings while the board lies still; the slopes stay. Refused when it never did.
tl::expected<AxesFit, WearableRefusal> gyroscope_still(std::span<const SteadyPart> parts,
                                                       const BoardCalibration& nominal);

}  // namespace secondskin::server
