#pragma once

#include <memory>
#include <string>
#include <vector>

#include "bus/participant.h"
#include "server/optical/optical_source.h"

/// What one needs to see while setting the optical system up: topics `points` and `raw` with every
/// frame, and `health` of a service "optical" with each detector's visibility, each tag's losses
/// and each projector's fit, once a second.
namespace secondskin::server {

class OpticalTopics {
 public:
  /// @param detectors  their names, in the order of the suit
  OpticalTopics(bus::Participant& participant, std::vector<std::string> detectors);
  ~OpticalTopics();

  /// For OpticalSource::observe.
  void publish(const OpticalSource& source, Next what);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::server
