#pragma once

#include <string>

namespace secondskin::server {

/// Why a calibration is not given out.
enum class RefusalKind {
  kTooFewPoints,  ///< fewer readings than the unknowns need, or too few views of each
  kDegenerate,    ///< on a line or a plane, or too small a part of the volume
  kDoesNotFit,    ///< no projectors explain the values
  kExchanged,     ///< detectors stand in each other's place in the configuration
  kMirror,        ///< nothing tells the world from its mirror image
  kNoFloor        ///< the wand was not laid down, or its places do not make a floor
};

struct Refusal {
  RefusalKind kind;
  std::string text;  ///< for the user: what is wrong, with numbers, and what to do
};

}  // namespace secondskin::server
