#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "motion/motion.h"
#include "motion/suit.h"
#include "sim/optical/virtual_rig.h"

/// Where on the body a photodetector should sit (Second Skin, 5.1): what each place sees of the
/// projectors over a motion, how well a point there is measured, and which places together measure
/// a segment best.
namespace secondskin::sim {

/// Places to try: every combination.
struct PlacementGrid {
  std::vector<Joint> segments;  ///< empty: the fifteen that suits/full_body.toml covers
  std::vector<double> along{0.1, 0.3, 0.5, 0.7, 0.9};
  std::size_t angles = 12;  ///< around the segment, from the front
};

struct PlacementOptions {
  std::size_t best = 6;         ///< how many to choose on each segment
  double step = 0.1;            ///< between the looked at instants [s]
  double smallest_gap = 0.025;  ///< between two chosen places [m]
};

/// What a place was worth over the motion.
struct PlacementScore {
  SuitDetector place;  ///< segment, along, angle; of a suit also its name, tag and input
  double visible;      ///< share of the time in which at least four projectors are seen (2.2.1)
  double planes;       ///< mean number of projectors seen
  double sigma;        ///< median over that time of the expected error of a point measured there,
                 ///< sqrt(trace((A^T A)^-1)) counts; A: a row a plane, dv/dp; NaN if never [m]
  std::size_t rank = 0;  ///< 1 to `best` where chosen, in the order of worth; else 0
};

/// What each detector of a suit sees over a motion; in the suit's order, nothing chosen.
/// @throws std::invalid_argument unless the motion is canonical and has poses.
std::vector<PlacementScore> score_suit(const Motion& canonical, const Suit& suit,
                                       std::span<const VirtualProjector> projectors,
                                       const OpticalNoise& noise,
                                       const PlacementOptions& options = {});

/// Scores every place of a grid and chooses the best of each segment: one after the other the place
/// that adds most to the mean over time of log det of the information on the segment's position and
/// orientation (greedy D-optimal design: a place is worth more where the others see nothing, and
/// far from their line).
std::vector<PlacementScore> sweep_places(const Motion& canonical, const PlacementGrid& grid,
                                         std::span<const VirtualProjector> projectors,
                                         const OpticalNoise& noise,
                                         const PlacementOptions& options = {});

}  // namespace secondskin::sim
