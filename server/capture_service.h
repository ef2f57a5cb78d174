#pragma once

#include <cstdint>
#include <stop_token>
#include <string>

#include "bus/participant.h"
#include "server/pose_source.h"

/// The capture server: runs one source and publishes the body, its poses and its health.
namespace secondskin::server {

struct CaptureOptions {
  std::string source_name;             ///< as the user named it
  double speed = 1.0;                  ///< times the source's own rate; 0: as fast as it can go
  bool loop = false;                   ///< start again at the end
  std::uint32_t wait_for_readers = 0;  ///< begin when so many read the poses (at most 5 s later)
};

struct CaptureCounts {
  std::uint64_t published = 0;
  std::uint64_t refused = 0;  ///< poses that were not valid and were not published
  std::uint64_t late = 0;     ///< poses published more than one period after their time
};

class CaptureService {
 public:
  /// @throws std::runtime_error when another capture server already serves the subject.
  CaptureService(bus::Participant& participant, PoseSource& source, const CaptureOptions& options);
  ~CaptureService();

  /// Publishes until the source ends or a stop is asked for. Poses of a recording are stamped anew
  /// with the time at which they are played.
  CaptureCounts run(std::stop_token stop);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::server
