#include "bus/raw.h"

#include <fmt/format.h>

#include <algorithm>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <stdexcept>

#include "bus/entities.h"
#include "bus/topics.h"

namespace secondskin::bus {
namespace {

using eprosima::fastrtps::rtps::InstanceHandle_t;
using eprosima::fastrtps::rtps::SerializedPayload_t;
using eprosima::fastrtps::types::ReturnCode_t;

// Takes any message for what it is: bytes.
class RawType final : public dds::TopicDataType {
 public:
  explicit RawType(std::string_view name) {
    setName(std::string(name).c_str());
    m_typeSize = 64 * 1024;  // the largest of any topic (references: 64 of 600 bytes) fits
    m_isGetKeyDefined = false;
  }
  bool serialize(void* data, SerializedPayload_t* payload) override {
    const auto& bytes = static_cast<const RawMessage*>(data)->bytes;
    if (bytes.size() < 4 || bytes.size() > payload->max_size) return false;
    std::copy(bytes.begin(), bytes.end(), payload->data);
    payload->length = static_cast<std::uint32_t>(bytes.size());
    payload->encapsulation = bytes[1] == 0 ? CDR_BE : CDR_LE;
    return true;
  }
  bool deserialize(SerializedPayload_t* payload, void* data) override {
    static_cast<RawMessage*>(data)->bytes.assign(payload->data, payload->data + payload->length);
    return true;
  }
  std::function<std::uint32_t()> getSerializedSizeProvider(void* data) override {
    return
        [data] { return static_cast<std::uint32_t>(static_cast<RawMessage*>(data)->bytes.size()); };
  }
  void* createData() override { return new RawMessage; }
  void deleteData(void* data) override { delete static_cast<RawMessage*>(data); }
  bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

}  // namespace

RawReader::RawReader(Participant& participant, std::size_t topic) {
  const auto& info = kTopics.at(topic);
  auto& e = participant.entities();
  endpoint().open(e, info, e.topic(info, dds::TypeSupport(new RawType(info.type_name)), true),
                  Want::kEvery);
}

RawReader::~RawReader() = default;

bool RawReader::take(RawMessage& message) noexcept {
  try {
    dds::SampleInfo info;
    while (endpoint_->reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
      if (!info.valid_data) continue;
      message.source_ns = info.source_timestamp.to_ns();
      endpoint_->taken.fetch_add(1, std::memory_order_relaxed);
      return true;
    }
  } catch (const std::exception&) {  // out of memory
    endpoint_->lost.fetch_add(1, std::memory_order_relaxed);
  }
  return false;
}

struct RawWriter::State {
  Participant::Entities* owner = nullptr;
  dds::DataWriter* writer = nullptr;
  ~State() {
    if (writer != nullptr) owner->publisher->delete_datawriter(writer);
  }
};

RawWriter::RawWriter(Participant& participant, std::size_t topic)
    : state_(std::make_unique<State>()) {
  const auto& info = kTopics.at(topic);
  auto& e = participant.entities();
  state_->owner = &e;
  state_->writer = e.publisher->create_datawriter_with_profile(
      e.topic(info, dds::TypeSupport(new RawType(info.type_name)), true), std::string(info.name));
  if (state_->writer == nullptr) {
    throw std::runtime_error(fmt::format(
        "topic {0}: no writer; the QoS file needs a data_writer profile '{0}'", info.name));
  }
}

RawWriter::~RawWriter() = default;

bool RawWriter::write(const RawMessage& message) noexcept {
  try {
    return state_->writer->write(const_cast<RawMessage*>(&message));
  } catch (const std::exception&) {
    return false;
  }
}

}  // namespace secondskin::bus
