#pragma once

#include <Eigen/Core>
#include <span>
#include <tl/expected.hpp>

#include "server/optical/calibrate/refusal.h"
#include "server/optical/projector.h"

/// The seven numbers of one projector from known points and what was received there (2.2.2).
namespace secondskin::server {

struct Reading {
  Eigen::Vector3d p_W;
  double value;  ///< [counts]; a mean of many is better than one
};

struct ProjectorFit {
  Projector projector;
  double residual = 0.0;    ///< RMS of the readings that fit [counts]
  std::size_t fitting = 0;  ///< readings within 3 counts
};

/// The paper's: least squares of x P11 + y P12 + z P13 + P14 - xv P21 - yv P22 - zv P23 = v, as it
/// stands. @return as fit_projector()
tl::expected<Projector, Refusal> fit_projector_algebraic(std::span<const Reading> readings);

/// Least squares of the counts themselves, normalised, with less weight for readings that do not
/// fit (Cauchy, 1 count), so that some readings may be wild.
/// @param draws  subsets that are tried as a start when a tenth of the readings or more do not fit
///               from the start with all of them
/// @return refused with fewer than seven readings, points on a line or in a plane, or values that
///         do not determine the seven numbers.
tl::expected<ProjectorFit, Refusal> fit_projector(std::span<const Reading> readings,
                                                  int draws = 100);

}  // namespace secondskin::server
