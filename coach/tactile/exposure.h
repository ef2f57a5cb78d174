#pragma once

#include <array>
#include <cstdint>

#include "coach/tactile/body_map.h"

/// What the skin under each tactor has borne, and when a site must rest. docs/tactile.md,
/// "Exposure", has the equations and says which figures are assumptions.
namespace secondskin::coach {

/// Action value of Directive 2002/44/EC for vibration of the hand, on ISO 5349-1's A(8): our daily
/// limit for any site [m/s^2 r.m.s. over 8 h].
inline constexpr double kDailyExposure = 2.5;
inline constexpr double kExposureDay = 8.0 * 3600.0;  ///< [s]
/// Of the daily dose: the rest is kept for alarms.
inline constexpr double kCueShareOfDose = 0.9;

inline constexpr double kLongestDuty = 0.6;     ///< share of time on
inline constexpr double kDutyWindow = 60.0;     ///< time constant of its average [s]
inline constexpr double kHottest = 10.0;        ///< voice coil over the skin: 33 to 43 C [K]
inline constexpr double kHeatAtFull = 15.0;     ///< where it settles at full drive, assumed [K]
inline constexpr double kHeatWindow = 40.0;     ///< time constant, assumed [s]
inline constexpr double kRestUntilShare = 0.8;  ///< of the limit that made a site rest

/// What one site has borne.
struct SiteExposure {
  double dose = 0.0;  ///< today: integral of the squared level [s at full drive]
  double duty = 0.0;  ///< share of the last minute that it was on, 0 to 1
  double heat = 0.0;  ///< of a voice coil above the skin's own temperature [K]
};

/// By channel.
struct ExposureState {
  std::int64_t stamp_ns = 0;  ///< to when it refers; 0 for never
  std::array<SiteExposure, wire::kTactorCount> sites{};
};

/// Share of time that a channel is on under a board state, and the mean of its squared level.
struct MeanDrive {
  double on = 0.0;
  double square = 0.0;
};
MeanDrive mean_drive(const wire::BoardState& board, std::size_t channel) noexcept;

/// A(8) of a dose: acceleration * sqrt(dose / 8 h). [m/s^2 r.m.s.]
double daily_exposure(const Tactor& tactor, double dose) noexcept;

/// Value type; no allocation.
class ExposureLimiter {
 public:
  /// A site that starts above a limit's resting share rests first.
  explicit ExposureLimiter(const BodyMap& map, const ExposureState& start = {}) noexcept;

  /// The board did this since the last call, but no longer than the command lived [s].
  void advance(std::int64_t stamp_ns, const wire::BoardState& board, double lifetime) noexcept;

  /// Whether a site must stay off now.
  bool rests(std::size_t channel, bool alarm) const noexcept;
  const ExposureState& state() const noexcept { return state_; }

 private:
  struct Limit {
    double dose = 0.0;  ///< a full day's; 0 where no tactor is
    bool heats = false;
  };
  ExposureState state_;
  std::array<Limit, wire::kTactorCount> limit_{};
  std::array<bool, wire::kTactorCount> resting_{};
};

}  // namespace secondskin::coach
