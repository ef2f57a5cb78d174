#pragma once

#include <memory>

#include "bus/participant.h"
#include "server/wearable/wearable_source.h"

/// What a wearable capture tells beside poses: topic `uncertainty` with every pose, and `health` of
/// a service "wearable" once a second: each board's rate, losses and the share of its readings that
/// fitted, and what the start found odd.
namespace secondskin::server {

class WearableTopics {
 public:
  WearableTopics(bus::Participant& participant, const WearableSource& source);
  ~WearableTopics();

  /// For WearableSource::observe.
  void publish(const WearableSource& source, Next what);

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace secondskin::server
