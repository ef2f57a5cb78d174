#pragma once

#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <tl/expected.hpp>
#include <vector>

#include "server/wearable/calibrate/inertial_calibration.h"
#include "server/wearable/signal/ultrasound.h"

/// The offset of each source, between its pulse's beginning and the inflection that is found, from
/// known distances (Practical Motion Capture, 4.3).
namespace secondskin::server {

/// A distance that was measured by hand. Placements are the ways in which sources and microphones
/// were set up, in the order of their recordings.
struct KnownSourceDistance {
  std::size_t placement = 0, source = 0, board = 0;
  double distance = 0.0;  ///< from the source's middle to the microphone [m]
};

/// Reads "placement,source,board,distance_m" with names of the garment's, a line a distance;
/// placements count from 0. @throws std::runtime_error naming file, line and what was expected.
std::vector<KnownSourceDistance> read_source_distances(const std::filesystem::path& file,
                                                       const Garment& garment);

/// Collects the arrivals of one placement.
class PlacementArrivals {
 public:
  PlacementArrivals(std::size_t sources, std::size_t boards);
  void add(std::size_t source, std::span<const std::optional<Arrival>> arrivals);

  struct Heard {
    double inflection = 0.0;  ///< median [A/D samples]
    double peak = 0.0;        ///< median
    std::size_t pulses = 0;
  };
  /// Empty unless half of the source's pulses were heard, five at least.
  std::optional<Heard> heard(std::size_t source, std::size_t board) const;

 private:
  std::size_t boards_;
  std::vector<std::size_t> sent_;               ///< pulses by source
  std::vector<std::vector<Arrival>> arrivals_;  ///< source-major
};

struct SourceOffset {
  SourceCalibration calibration;
  std::size_t distances = 0;  ///< that it is the mean of
};

struct SourceOffsets {
  std::vector<SourceOffset> sources;
  /// Leave-one-out: a placement's distances with offsets from all others, |error| [m].
  std::vector<double> left_out;
  double left_out_mean = 0.0, left_out_sd = 0.0;
  std::size_t unheard = 0;  ///< known distances over which nothing was heard
  /// The air's temperature by the distances themselves, and its standard deviation [deg C].
  double implied_temperature = 0.0, implied_sigma = 0.0;
};

/// Refused naming the sources that lack distances: each needs two placements at least.
/// @param temperature  of the air [deg C]
tl::expected<SourceOffsets, WearableRefusal> solve_source_offsets(
    const Garment& garment, std::span<const PlacementArrivals> placements,
    std::span<const KnownSourceDistance> known, double temperature);

}  // namespace secondskin::server
