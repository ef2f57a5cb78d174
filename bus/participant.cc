#include "bus/participant.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/log/Log.hpp>

#include <algorithm>
#include <cctype>
#include <set>
#include <stdexcept>

#include "bus/entities.h"
#include "bus/topics.h"

namespace secondskin::bus {
namespace {

using eprosima::fastdds::rtps::UDPv4TransportDescriptor;
using eprosima::fastrtps::rtps::IPLocator;
using eprosima::fastrtps::rtps::Locator_t;
using eprosima::fastrtps::types::ReturnCode_t;

// How many programs of one domain find each other on this machine by unicast; each costs every
// other one a small packet an announcement.
constexpr std::uint32_t kParticipantsOnThisMachine = 24;
constexpr std::uint32_t kLargestDomain = 232;  // RTPS 2.2, 9.6.1: ports run out above

// The middleware's own words go where ours go.
class LogToSpdlog final : public dds::LogConsumer {
 public:
  // Held: the middleware's logging thread outlives spdlog's registry at the program's end.
  explicit LogToSpdlog(std::shared_ptr<spdlog::logger> logger) : logger_(std::move(logger)) {}
  void Consume(const dds::Log::Entry& entry) override {
    const auto level =
        entry.kind == dds::Log::Kind::Error ? spdlog::level::warn : spdlog::level::debug;
    logger_->log(level, "DDS: {} ({})", entry.message, entry.context.category);
  }

 private:
  std::shared_ptr<spdlog::logger> logger_;
};

void load_profiles_once(const std::filesystem::path& file) {
  static std::mutex mutex;
  static std::set<std::filesystem::path> loaded;
  const std::lock_guard lock(mutex);
  if (loaded.empty()) {
    dds::Log::ClearConsumers();
    dds::Log::RegisterConsumer(std::make_unique<LogToSpdlog>(spdlog::default_logger()));
  }
  std::error_code error;
  const auto path = std::filesystem::canonical(file, error);
  if (error) {
    throw std::runtime_error(fmt::format("QoS file {}: {}", file.string(), error.message()));
  }
  if (loaded.contains(path)) return;
  auto* factory = dds::DomainParticipantFactory::get_instance();
  if (factory->load_XML_profiles_file(path.string()) != ReturnCode_t::RETCODE_OK) {
    throw std::runtime_error(
        fmt::format("QoS file {}: not a valid Fast DDS profiles file", path.string()));
  }
  loaded.insert(path);
}

void check(const Config& config) {
  const bool plain = !config.subject.empty() && config.subject.size() <= 64 &&
                     std::all_of(config.subject.begin(), config.subject.end(),
                                 [](unsigned char c) { return std::isalnum(c) != 0 || c == '_'; });
  if (!plain) {
    throw std::runtime_error(fmt::format(
        "subject '{}': expected 1 to 64 letters, digits or '_'; it is part of the topics' names",
        config.subject));
  }
  if (config.domain > kLargestDomain) {
    throw std::runtime_error(
        fmt::format("domain {}: expected 0 to {}", config.domain, kLargestDomain));
  }
}

dds::DomainParticipantQos qos_of(const Config& config) {
  dds::DomainParticipantQos qos;
  qos.name(config.name);
  qos.transport().use_builtin_transports = false;
  auto udp = std::make_shared<UDPv4TransportDescriptor>();
  auto& discovery = qos.wire_protocol().builtin;
  // A killed program is forgotten, and its liveliness lost, within this.
  discovery.discovery_config.leaseDuration = {5, 0};
  discovery.discovery_config.leaseDuration_announcementperiod = {1, 0};
  // A first announcement can pass before the other side listens; the next one is then soon.
  discovery.discovery_config.initial_announcements.count = 25;
  discovery.discovery_config.initial_announcements.period = {0, 20'000'000};
  if (config.reach == Reach::kThisMachine) {
    udp->interfaceWhiteList.emplace_back("127.0.0.1");
    udp->maxInitialPeersRange = kParticipantsOnThisMachine;
    Locator_t loopback;
    IPLocator::setIPv4(loopback, 127, 0, 0, 1);
    loopback.port = 0;  // the well-known ports of the domain's participants
    discovery.initialPeersList.push_back(loopback);
    discovery.metatrafficUnicastLocatorList.push_back(loopback);
  }
  qos.transport().user_transports.push_back(udp);
  return qos;
}

}  // namespace

std::int64_t now_ns() noexcept {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::system_clock::now().time_since_epoch())
      .count();
}

Participant::Participant(const Config& config) : entities_(std::make_unique<Entities>()) {
  check(config);
  load_profiles_once(config.qos_file);
  auto& e = *entities_;
  e.config = config;
  auto* factory = dds::DomainParticipantFactory::get_instance();
  e.participant = factory->create_participant(config.domain, qos_of(config));
  if (e.participant != nullptr) {
    e.publisher = e.participant->create_publisher(dds::PUBLISHER_QOS_DEFAULT);
    e.subscriber = e.participant->create_subscriber(dds::SUBSCRIBER_QOS_DEFAULT);
  }
  if (e.publisher == nullptr || e.subscriber == nullptr) {
    throw std::runtime_error(fmt::format(
        "cannot join DDS domain {}: try another --domain or 'secondskin doctor'", config.domain));
  }
}

Participant::~Participant() {
  auto* p = entities_->participant;
  if (p == nullptr) return;
  p->delete_contained_entities();
  dds::DomainParticipantFactory::get_instance()->delete_participant(p);
}

const Config& Participant::config() const noexcept { return entities_->config; }

dds::Topic* Participant::Entities::topic(const TopicInfo& info, dds::TypeSupport type, bool raw) {
  const std::lock_guard lock(mutex);
  const std::string key = fmt::format("{}{}", info.name, raw ? "#raw" : "");
  if (const auto found = topics.find(key); found != topics.end()) return found->second;
  const std::string other = raw ? std::string(info.name) : fmt::format("{}#raw", info.name);
  if (topics.contains(other)) {
    throw std::runtime_error(
        fmt::format("topic {}: read both raw and typed in one participant; use two", info.name));
  }
  dds::Topic* made = nullptr;
  if (type.register_type(participant) == ReturnCode_t::RETCODE_OK) {
    made = participant->create_topic(full_topic_name(config.subject, info.name),
                                     std::string(info.type_name), dds::TOPIC_QOS_DEFAULT);
  }
  if (made == nullptr) {
    throw std::runtime_error(
        fmt::format("topic {}: cannot be made in domain {}", info.name, config.domain));
  }
  topics.emplace(key, made);
  return made;
}

}  // namespace secondskin::bus
