#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "motion/anatomy.h"
#include "wire/tactor_protocol.h"
#include "wire/tactor_waveform.h"

/// Where each tactor sits on the body.
namespace secondskin::coach {

/// What is assumed of an actuator whose acceleration nobody measured [m/s^2 r.m.s., weighted].
double default_acceleration(wire::Actuator actuator) noexcept;

/// One tactor. Its place is given on a segment: how far along the limb and at which angle around
/// it.
struct Tactor {
  std::size_t channel = 0;  ///< 0 to 15, the board's
  Joint segment{};          ///< the segment that it is worn on
  double along = 0.5;       ///< 0 at the proximal joint, 1 at the distal end
  double angle =
      0.0;  ///< around the segment's long axis: 0 front (x), pi/2 left (y) in the rest pose [rad]
  wire::Actuator actuator = wire::Actuator::kVoiceCoil;
  double threshold = 0.3;  ///< faintest level that is felt, 0 to 1
  double ceiling = 1.0;    ///< strongest level allowed, 0 to 1
  /// Of the skin under it at full drive, frequency-weighted after ISO 5349-1 [m/s^2 r.m.s.].
  double acceleration = default_acceleration(wire::Actuator::kVoiceCoil);
  /// Bit c: no phantom is made between this tactor and channel c (the learner confuses them).
  std::uint16_t no_phantom_with = 0;
};

/// A body map: at most sixteen tactors on distinct channels. Channels 4g to 4g+3 on one segment, in
/// order around it, form ring g, which can run saltation.
struct BodyMap {
  std::string name;
  bool repulsive = true;  ///< cue on the side to move away from (TIKL); else the side to go to
  std::vector<Tactor> tactors;

  /// Reads body_maps/NAME.toml: name, cue = "repulsive"|"attractive", [[tactor]] channel, segment,
  /// along, angle_deg, actuator = "voice_coil"|"dc_motor", threshold, ceiling, and if measured
  /// acceleration.
  /// @throws std::runtime_error naming file, line, field and what was expected.
  static BodyMap load(const std::filesystem::path& file);
};

}  // namespace secondskin::coach
