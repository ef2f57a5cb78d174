#pragma once

#include <optional>
#include <string>

#include "motion/skeleton.h"

namespace secondskin::server {

/// What came of asking a source for its next pose.
enum class Next {
  kPose,
  kSilence,  ///< a live source has had nothing for a quarter of a second; ask again
  kEnd,
};

/// Anything that yields poses of one canonical body: a recording, a capture system, a simulation.
/// Belongs to the capture service; not safe to share between threads.
class PoseSource {
 public:
  virtual ~PoseSource() = default;

  virtual const Skeleton& skeleton() const = 0;
  /// Whether skeleton() and rate_hz() already hold; if not, they do from the first pose on.
  virtual bool knows_body() const { return true; }
  virtual double rate_hz() const = 0;  ///< nominal

  /// Gives the next pose. Its frame counts the samples, those that were lost too. Its stamp is the
  /// time of measurement: for a recording, from the recording, so only differences mean something.
  /// Poses that are not valid are passed on as they are; the service refuses and counts them.
  [[nodiscard]] virtual Next next(StampedPose& pose) = 0;

  /// Starts again from the beginning. @returns false for a source that cannot (a live one).
  virtual bool rewind() = 0;

  /// Whether poses come as they are measured: next() waits for them, and their stamps are times
  /// since the Unix epoch.
  virtual bool live() const { return false; }

  /// Of a live source: why poses may not come, and what to do; empty when nothing is known.
  virtual std::string trouble() const { return {}; }
};

}  // namespace secondskin::server
