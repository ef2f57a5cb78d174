#pragma once

// Fast DDS inside; included only by this folder's sources.
#include <atomic>
#include <fastdds/dds/core/condition/GuardCondition.hpp>
#include <fastdds/dds/core/condition/StatusCondition.hpp>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <map>
#include <mutex>
#include <string>

#include "bus/participant.h"
#include "bus/reader.h"

namespace secondskin::bus {

namespace dds = eprosima::fastdds::dds;

inline eprosima::fastrtps::Duration_t to_duration(std::chrono::nanoseconds time) {
  constexpr std::int64_t kSecond = 1'000'000'000;
  return {static_cast<std::int32_t>(time.count() / kSecond),
          static_cast<std::uint32_t>(time.count() % kSecond)};
}

struct Participant::Entities {
  Config config;
  dds::DomainParticipant* participant = nullptr;
  dds::Publisher* publisher = nullptr;
  dds::Subscriber* subscriber = nullptr;
  std::mutex mutex;
  std::map<std::string, dds::Topic*> topics;

  /// The participant's topic of that name, made at its first use.
  /// @throws std::runtime_error when the type or topic cannot be made, or the topic is already used
  ///         here with another representation (raw and typed do not mix in one participant).
  dds::Topic* topic(const TopicInfo& info, dds::TypeSupport type, bool raw);
};

/// Counts what happens at a reader and tells the wait set of it.
struct ReaderBase::Endpoint final : dds::DataReaderListener {
  Participant::Entities* owner = nullptr;
  dds::DataReader* reader = nullptr;
  std::mutex calls;                     ///< held in every callback and by whoever changes `news`
  dds::GuardCondition* news = nullptr;  ///< guarded by `calls`
  std::atomic<std::uint64_t> taken{0}, lost{0}, deadline_missed{0}, incompatible{0};
  std::atomic<std::uint32_t> writers{0}, alive_writers{0};

  /// @throws std::runtime_error naming topic and profile.
  void open(Participant::Entities& entities, const TopicInfo& info, dds::Topic* topic, Want want);
  ~Endpoint() override;

  /// Whom to tell from now on; nullptr: nobody. Whoever was told before may go afterwards.
  void tell_through(dds::GuardCondition* condition);

  void on_subscription_matched(dds::DataReader*, const dds::SubscriptionMatchedStatus&) override;
  void on_liveliness_changed(dds::DataReader*, const dds::LivelinessChangedStatus&) override;
  void on_requested_deadline_missed(dds::DataReader*,
                                    const dds::RequestedDeadlineMissedStatus&) override;
  void on_sample_lost(dds::DataReader*, const dds::SampleLostStatus&) override;
  void on_requested_incompatible_qos(dds::DataReader*,
                                     const dds::RequestedIncompatibleQosStatus&) override;

 private:
  void tell() noexcept;  // with `calls` held
};

}  // namespace secondskin::bus
