#pragma once

#include <memory>
#include <string>
#include <vector>

#include "server/optical/tag_merger.h"
#include "server/pose_source.h"
#include "wire/photo_tag.h"

/// From the tags' bytes to frames: reads serial ports as bytes come, or recorded byte files as fast
/// as it is asked to. A port that vanishes is opened again when it is back; the other tags go on.
namespace secondskin::server {

/// Which bytes to expect.
struct OpticalFormat {
  std::vector<std::size_t> detectors;  ///< of each tag
  std::size_t projectors = 16;
  bool gray = false;  ///< as wire::TagFormat
};

/// How one tag fares.
struct TagStatus {
  std::string place;  ///< its port or file
  bool connected = false;
  bool alive = false;   ///< has delivered sets of late
  std::string trouble;  ///< what is wrong with its port; empty when nothing is
  wire::TagCounters bytes;
  TagMergeCounters sets;
};

class OpticalReceiver {
 public:
  /// The tag's radio link appears as a serial port (2.1.3); 18 detectors need 180 kbaud.
  static constexpr unsigned kBaudRate = 230'400;

  /// @param places  a port or file a tag; either all are ports (character devices, or not there
  ///                yet) or all are files
  /// @throws std::runtime_error naming the place, and what was expected
  OpticalReceiver(const std::vector<std::string>& places, const OpticalFormat& format);
  ~OpticalReceiver();

  /// Whether the bytes come from ports, now.
  bool live() const noexcept;

  /// Gives the next frame; waits for it, but not longer than a quarter of a second. Stamps of a
  /// live frame are since the Unix epoch, of a file since its beginning.
  [[nodiscard]] Next next(ProjectorFrame& frame);

  std::size_t tags() const noexcept;
  std::size_t detectors() const noexcept;  ///< of all tags
  std::size_t projectors() const noexcept;
  const OpticalFormat& format() const noexcept;
  /// For the thread that calls next().
  TagStatus status(std::size_t tag) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::server
