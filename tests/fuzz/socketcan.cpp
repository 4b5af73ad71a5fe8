// SPDX-License-Identifier: Apache-2.0
// SocketCAN: packets of any bytes and length into the codec, and through a socket into the bus.
#include "spine/hal/bus/socketcan/socketcan_codec.hpp"

#include <linux/can/error.h>
#include <sys/socket.h>
#include <unistd.h>

#include "spine/hal/bus/socketcan/socketcan_bus.hpp"
#include "tests/fuzz/fuzz.hpp"

namespace lithe::fuzz {
namespace {

using namespace hal;
using socketcan::Kind;

constexpr std::size_t kLongestPacket = 80;  // the kernel's have 16 or 72 bytes
constexpr std::size_t kMostPackets = 64;

struct Told {
  std::vector<Frame> frames;
  std::uint64_t errors = 0, malformed = 0, ignored = 0;
};

void there_and_back(const Frame& frame) {
  require(is_can(frame), "a frame of the kernel's is one that CAN has");
  canfd_frame raw;
  const std::size_t size = socketcan::encode(frame, raw);
  Frame again;
  require(size == (frame.fd ? CANFD_MTU : CAN_MTU), "every frame can be sent");
  require(socketcan::decode(std::as_bytes(std::span(&raw, 1)).first(size), again) == Kind::frame && same(again, frame),
          "a frame is read as it was sent");
}

void one_packet(std::span<const std::byte> packet, Told& told) {
  Frame untouched;
  untouched.id = 0x123;
  Frame frame = untouched;
  const Kind kind = socketcan::decode(packet, frame);
  require(kind == Kind::frame || same(frame, untouched), "only a frame changes the frame");
  require(kind == Kind::malformed || packet.size() == CAN_MTU || packet.size() == CANFD_MTU, "a packet is whole");
  if (kind == Kind::frame) {
    std::uint32_t id = 0;
    std::memcpy(&id, packet.data(), sizeof(id));
    const auto data = std::as_bytes(frame.payload());
    require(frame.id == (id & kLargestId) && std::equal(data.begin(), data.end(), packet.begin() + 8),
            "it is all there");
    there_and_back(frame);
    told.frames.push_back(frame);
  }
  told.errors += kind == Kind::error || kind == Kind::bus_off || kind == Kind::restarted ? 1 : 0;
  told.malformed += kind == Kind::malformed ? 1 : 0;
  told.ignored += kind == Kind::remote ? 1 : 0;
}

}  // namespace

void run(Bytes bytes) {
  std::array<int, 2> ends{};
  require(socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_NONBLOCK, 0, ends.data()) == 0, "a socket opens");
  auto bus = SocketCanBus::open(
      {"can0"}, [&]() -> Result<Descriptor> { return Descriptor(ends[0]); }, [] { return SocketCanBus::Carrier::on; });
  Told told;
  Input input(bytes);
  for (std::size_t i = 0; i < kMostPackets && !input.empty(); ++i) {
    const auto packet = std::as_bytes(input.bytes(input.byte() % (kLongestPacket + 1)));
    if (packet.empty()) continue;
    one_packet(packet, told);
    require(write(ends[1], packet.data(), packet.size()) == static_cast<ssize_t>(packet.size()), "a packet is sent");
  }
  std::vector<Frame> frames;
  Frame frame;
  for (std::size_t looks = 0; looks < 2; ++looks) {
    (*bus)->begin(0);
    while ((*bus)->receive(frame)) frames.push_back(frame);
  }
  const BusStatistics& count = (*bus)->statistics();
  require(count.received == frames.size() && count.errors == told.errors && count.malformed == told.malformed &&
              count.ignored == told.ignored,
          "every packet is counted once, as what it is");
  require(frames.size() == told.frames.size() && std::equal(frames.begin(), frames.end(), told.frames.begin(), same),
          "the frames of the socket are those of the packets");
  close(ends[1]);
}

std::vector<Seed> seeds() {
  Script all;
  std::vector<Seed> each;
  const auto add = [&](const canfd_frame& raw, std::size_t size) {
    const std::string_view packet(reinterpret_cast<const char*>(&raw), std::min(size, sizeof(raw)));
    all.byte(static_cast<unsigned>(size)).text(packet);
    each.push_back(Script().byte(static_cast<unsigned>(size)).text(packet));
  };
  for (const canid_t id : {0x123U, 0x8001U | CAN_EFF_FLAG, 0x7ffU | CAN_RTR_FLAG, 0x800U, CAN_ERR_FLAG | CAN_ERR_BUSOFF,
                           CAN_ERR_FLAG | CAN_ERR_RESTARTED | CAN_ERR_CRTL | CAN_ERR_ACK}) {
    canfd_frame raw{};
    raw.can_id = id;
    for (const std::uint8_t size : List<std::uint8_t>{0, 1, 8, 9, 12, 64, 255}) {
      raw.len = size;
      raw.flags = CANFD_BRS;
      std::memset(raw.data, size, sizeof(raw.data));
      add(raw, CAN_MTU);
      add(raw, CANFD_MTU);
      add(raw, CAN_MTU - 1);
    }
  }
  each.push_back(all);
  return each;
}

}  // namespace lithe::fuzz
