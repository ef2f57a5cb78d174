#pragma once

#include <array>
#include <cstddef>
#include <span>

/// How far the felt path of saltation is from the real one: the Bayesian observer of Goldreich 2007
/// ("A Bayesian perceptual model replicates the cutaneous rabbit and other tactile spatiotemporal
/// illusions", PLoS ONE 2(3):e333), who expects that things on the skin move slowly.
namespace secondskin::coach {

/// lambda = sigma_v / sigma_s of the forearm: 10 cm/s of expected speed, 1 cm of spatial
/// uncertainty.
inline constexpr double kForearmLambda = 10.0;  ///< [1/s]

/// Felt distance of two taps over the real one: 1 / (1 + 2 / (lambda t)^2).
/// @param interval  from the onset of one to the onset of the other [s]
double felt_distance_ratio(double interval, double lambda = kForearmLambda) noexcept;

/// Taps of one board ring: each of four sites twice, round and round.
inline constexpr std::size_t kMostTaps = 64;

/// Where each of a row of equally timed taps is felt: the positions x that are likeliest, given
/// where each was (uncertain by sigma_s) and that x changes slowly (by sigma_v times the interval):
///   minimise  sum (x_i - p_i)^2 / (2 sigma_s^2) + sum (x_{i+1} - x_i)^2 / (2 (sigma_v t)^2).
/// For two taps this is felt_distance_ratio().
/// @param position  where the taps are, along the skin; at most kMostTaps are taken
/// @param felt      out: one for each position
void felt_positions(std::span<const double> position, double interval, double lambda,
                    std::span<double> felt) noexcept;

}  // namespace secondskin::coach
