#include "bus/wait_set.h"

#include <fastdds/dds/core/condition/WaitSet.hpp>

#include "bus/entities.h"

namespace secondskin::bus {

struct WaitSet::State {
  dds::WaitSet set;
  dds::GuardCondition news;
  dds::ConditionSeq active;
  std::vector<ReaderBase*> readers;
};

WaitSet::WaitSet() : state_(std::make_unique<State>()) {
  state_->set.attach_condition(state_->news);
}

WaitSet::~WaitSet() {
  for (auto* reader : state_->readers) {
    reader->endpoint().tell_through(nullptr);
    state_->set.detach_condition(reader->endpoint().reader->get_statuscondition());
  }
  state_->set.detach_condition(state_->news);
}

void WaitSet::attach(ReaderBase& reader) {
  state_->set.attach_condition(reader.endpoint().reader->get_statuscondition());
  reader.endpoint().tell_through(&state_->news);
  state_->readers.push_back(&reader);
}

bool WaitSet::wait(std::chrono::nanoseconds at_most) noexcept {
  const auto result = state_->set.wait(state_->active, to_duration(at_most));
  state_->news.set_trigger_value(false);
  return result == eprosima::fastrtps::types::ReturnCode_t::RETCODE_OK;
}

void WaitSet::wake() noexcept { state_->news.set_trigger_value(true); }

}  // namespace secondskin::bus
