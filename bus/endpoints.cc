#include <fastcdr/Cdr.h>
#include <fmt/format.h>

#include <condition_variable>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/DataWriterListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <stdexcept>

#include "bus/entities.h"
#include "bus/reader.h"
#include "bus/topics.h"
#include "bus/writer.h"
#include "secondskin_msgsPubSubTypes.h"

namespace secondskin::bus {
namespace {

using eprosima::fastrtps::rtps::SerializedPayload_t;
using eprosima::fastrtps::types::ReturnCode_t;

// The generated type support of each message.
template <class Message>
struct Support;
template <>
struct Support<msg::SkeletonDefinition> {
  using Type = msg::SkeletonDefinitionPubSubType;
};
template <>
struct Support<msg::SkeletonPose> {
  using Type = msg::SkeletonPosePubSubType;
};
template <>
struct Support<msg::MarkerCloud> {
  using Type = msg::MarkerCloudPubSubType;
};
template <>
struct Support<msg::ProjectorValues> {
  using Type = msg::ProjectorValuesPubSubType;
};
template <>
struct Support<msg::PoseUncertainty> {
  using Type = msg::PoseUncertaintyPubSubType;
};
template <>
struct Support<msg::ServiceHealth> {
  using Type = msg::ServiceHealthPubSubType;
};
template <>
struct Support<msg::ReferenceMotionList> {
  using Type = msg::ReferenceMotionListPubSubType;
};
template <>
struct Support<msg::SessionCommand> {
  using Type = msg::SessionCommandPubSubType;
};
template <>
struct Support<msg::SessionState> {
  using Type = msg::SessionStatePubSubType;
};
template <>
struct Support<msg::Alignment> {
  using Type = msg::AlignmentPubSubType;
};
template <>
struct Support<msg::Correction> {
  using Type = msg::CorrectionPubSubType;
};
template <>
struct Support<msg::TactorCommand> {
  using Type = msg::TactorCommandPubSubType;
};
template <>
struct Support<msg::EmergencyStop> {
  using Type = msg::EmergencyStopPubSubType;
};
template <>
struct Support<msg::RepetitionScore> {
  using Type = msg::RepetitionScorePubSubType;
};

template <class Message>
constexpr const TopicInfo& info_of() noexcept {
  return kTopics[kTopicOf<Message>];
}

}  // namespace

// ---- bytes

template <TopicMessage Message>
std::vector<std::uint8_t> encode(const Message& message) {
  using eprosima::fastcdr::Cdr;
  typename Support<Message>::Type support;
  // serialize only reads, but its signature is not const.
  auto* data = const_cast<Message*>(&message);
  SerializedPayload_t payload(support.getSerializedSizeProvider(data)());
  if (!support.serialize(data, &payload)) {
    throw std::runtime_error(
        fmt::format("topic {}: a message exceeds its bounds", info_of<Message>().name));
  }
  return {payload.data, payload.data + payload.length};
}

template <TopicMessage Message>
bool decode(std::span<const std::uint8_t> bytes, Message& message) {
  if (bytes.size() < 4) return false;
  typename Support<Message>::Type support;
  SerializedPayload_t payload;
  payload.data = const_cast<std::uint8_t*>(bytes.data());  // read only
  payload.length = payload.max_size = static_cast<std::uint32_t>(bytes.size());
  bool whole = false;
  try {
    whole = support.deserialize(&payload, &message);
  } catch (const std::exception&) {
    whole = false;  // a length that the bytes do not hold
  }
  payload.data = nullptr;  // not ours to free
  return whole;
}

// ---- writer

template <TopicMessage Message>
struct Writer<Message>::State final : dds::DataWriterListener {
  Participant::Entities* owner = nullptr;
  dds::DataWriter* writer = nullptr;
  std::atomic<std::uint64_t> written{0}, refused{0}, incompatible{0};
  std::atomic<std::uint32_t> readers{0};
  std::mutex mutex;
  std::condition_variable_any matched;

  void on_publication_matched(dds::DataWriter*,
                              const dds::PublicationMatchedStatus& status) override {
    const std::lock_guard lock(mutex);
    readers = static_cast<std::uint32_t>(status.current_count);
    matched.notify_all();
  }
  void on_offered_incompatible_qos(dds::DataWriter*,
                                   const dds::OfferedIncompatibleQosStatus& status) override {
    const std::lock_guard lock(mutex);
    incompatible = status.total_count;
  }
  ~State() override {
    if (writer != nullptr) {
      writer->set_listener(nullptr);
      owner->publisher->delete_datawriter(writer);
    }
    const std::lock_guard last_call(mutex);  // a callback that had begun has ended
  }
};

template <TopicMessage Message>
Writer<Message>::Writer(Participant& participant) : state_(std::make_unique<State>()) {
  auto& e = participant.entities();
  const auto& info = info_of<Message>();
  auto* topic = e.topic(info, dds::TypeSupport(new typename Support<Message>::Type), false);
  state_->owner = &e;
  const std::string profile(info.name);
  state_->writer = e.publisher->create_datawriter_with_profile(
      topic, profile, state_.get(),
      dds::StatusMask::publication_matched() << dds::StatusMask::offered_incompatible_qos());
  if (state_->writer == nullptr) {
    throw std::runtime_error(fmt::format(
        "topic {0}: no writer; the QoS file needs a data_writer profile '{0}'", info.name));
  }
}

template <TopicMessage Message>
Writer<Message>::~Writer() = default;

template <TopicMessage Message>
bool Writer<Message>::write(const Message& message) noexcept {
  try {
    if (state_->writer->write(const_cast<Message*>(&message))) {
      state_->written.fetch_add(1, std::memory_order_relaxed);
      return true;
    }
  } catch (const std::exception&) {  // a bound exceeded while serialising
  }
  state_->refused.fetch_add(1, std::memory_order_relaxed);
  return false;
}

template <TopicMessage Message>
WriterCounts Writer<Message>::counts() const noexcept {
  return {state_->written, state_->refused, state_->readers, state_->incompatible};
}

template <TopicMessage Message>
bool Writer<Message>::wait_for_readers(std::uint32_t at_least, std::chrono::nanoseconds at_most,
                                       std::stop_token stop) {
  std::unique_lock lock(state_->mutex);
  return state_->matched.wait_for(lock, stop, at_most, [&] { return state_->readers >= at_least; });
}

template <TopicMessage Message>
bool Writer<Message>::wait_until_delivered(std::chrono::nanoseconds at_most) {
  return state_->writer->wait_for_acknowledgments(to_duration(at_most)) == ReturnCode_t::RETCODE_OK;
}

// ---- reader

ReaderBase::ReaderBase() : endpoint_(std::make_unique<Endpoint>()) {}

ReaderCounts ReaderBase::counts() const noexcept {
  return {endpoint_->taken,   endpoint_->lost,          endpoint_->deadline_missed,
          endpoint_->writers, endpoint_->alive_writers, endpoint_->incompatible};
}

void ReaderBase::Endpoint::open(Participant::Entities& entities, const TopicInfo& info,
                                dds::Topic* topic, Want want) {
  owner = &entities;
  const std::string profile = fmt::format("{}{}", info.name, want == Want::kEvery ? ".every" : "");
  reader = entities.subscriber->create_datareader_with_profile(
      topic, profile, this,
      dds::StatusMask::subscription_matched()
          << dds::StatusMask::liveliness_changed() << dds::StatusMask::requested_deadline_missed()
          << dds::StatusMask::sample_lost() << dds::StatusMask::requested_incompatible_qos());
  if (reader == nullptr) {
    throw std::runtime_error(fmt::format(
        "topic {}: no reader; the QoS file needs a data_reader profile '{}'", info.name, profile));
  }
  reader->get_statuscondition().set_enabled_statuses(dds::StatusMask::data_available());
}

ReaderBase::Endpoint::~Endpoint() {
  if (reader != nullptr) {
    reader->set_listener(nullptr);
    owner->subscriber->delete_datareader(reader);
  }
  const std::lock_guard last_call(calls);  // a callback that had begun has ended
}

void ReaderBase::Endpoint::tell_through(dds::GuardCondition* condition) {
  const std::lock_guard lock(calls);
  news = condition;
}

void ReaderBase::Endpoint::tell() noexcept {
  if (news != nullptr) news->set_trigger_value(true);
}

void ReaderBase::Endpoint::on_subscription_matched(dds::DataReader*,
                                                   const dds::SubscriptionMatchedStatus& status) {
  const std::lock_guard lock(calls);
  writers = static_cast<std::uint32_t>(status.current_count);
  tell();
}

void ReaderBase::Endpoint::on_liveliness_changed(dds::DataReader*,
                                                 const dds::LivelinessChangedStatus& status) {
  const std::lock_guard lock(calls);
  alive_writers = static_cast<std::uint32_t>(status.alive_count);
  tell();
}

void ReaderBase::Endpoint::on_requested_deadline_missed(
    dds::DataReader*, const dds::RequestedDeadlineMissedStatus& status) {
  const std::lock_guard lock(calls);
  deadline_missed = status.total_count;
}

void ReaderBase::Endpoint::on_sample_lost(dds::DataReader*, const dds::SampleLostStatus& status) {
  const std::lock_guard lock(calls);
  lost = static_cast<std::uint64_t>(status.total_count);
}

void ReaderBase::Endpoint::on_requested_incompatible_qos(
    dds::DataReader*, const dds::RequestedIncompatibleQosStatus& status) {
  const std::lock_guard lock(calls);
  incompatible = status.total_count;
  tell();
}

template <TopicMessage Message>
Reader<Message>::Reader(Participant& participant, Want want) {
  auto& e = participant.entities();
  const auto& info = info_of<Message>();
  endpoint().open(
      e, info, e.topic(info, dds::TypeSupport(new typename Support<Message>::Type), false), want);
}

template <TopicMessage Message>
Reader<Message>::~Reader() = default;

template <TopicMessage Message>
bool Reader<Message>::take(Message& message) noexcept {
  try {
    dds::SampleInfo info;
    while (endpoint_->reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
      if (info.valid_data) {
        endpoint_->taken.fetch_add(1, std::memory_order_relaxed);
        return true;
      }
    }
  } catch (const std::exception&) {  // bytes that are no message of this type
    endpoint_->lost.fetch_add(1, std::memory_order_relaxed);
  }
  return false;
}

#define SECONDSKIN_TOPIC(Message)                                 \
  template class Writer<msg::Message>;                            \
  template class Reader<msg::Message>;                            \
  template std::vector<std::uint8_t> encode(const msg::Message&); \
  template bool decode(std::span<const std::uint8_t>, msg::Message&);
SECONDSKIN_TOPIC(SkeletonDefinition)
SECONDSKIN_TOPIC(SkeletonPose)
SECONDSKIN_TOPIC(MarkerCloud)
SECONDSKIN_TOPIC(ProjectorValues)
SECONDSKIN_TOPIC(ServiceHealth)
SECONDSKIN_TOPIC(ReferenceMotionList)
SECONDSKIN_TOPIC(SessionCommand)
SECONDSKIN_TOPIC(SessionState)
SECONDSKIN_TOPIC(Alignment)
SECONDSKIN_TOPIC(Correction)
SECONDSKIN_TOPIC(TactorCommand)
SECONDSKIN_TOPIC(EmergencyStop)
SECONDSKIN_TOPIC(RepetitionScore)
SECONDSKIN_TOPIC(PoseUncertainty)
#undef SECONDSKIN_TOPIC

}  // namespace secondskin::bus
