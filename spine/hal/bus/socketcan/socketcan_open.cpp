// SPDX-License-Identifier: Apache-2.0
#include <linux/can/error.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <net/if_arp.h>
#include <sys/ioctl.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstring>
#include <string>

#include "spine/hal/bus/socketcan/socketcan_bus.hpp"

namespace lithe::hal {
namespace {

// The default transmit queue has 10 frames, less than one exchange of a large robot. With bit rate switching all nodes
// need the same sample points, and the kernel's default is not what drives use.
std::string bring_up(const SocketCanParams& params) {
  std::string command = "sudo ip link set " + params.interface + " up txqueuelen 128 type can bitrate " +
                        std::to_string(params.bitrate) + " restart-ms 100";
  if (params.data_bitrate > 0) {
    command += " dbitrate " + std::to_string(params.data_bitrate) +
               " fd on sample-point 0.666 dsample-point 0.666 sjw 10 dsjw 5";
  }
  return command;
}

Error wrong(const SocketCanParams& params, const std::string& what) { return Error{params.interface + ": " + what}; }

// The interface's index; or why it cannot be used as configured.
Result<int> find_interface(int socket, const SocketCanParams& params) {
  ifreq request{};
  if (params.interface.empty() || params.interface.size() >= sizeof request.ifr_name)
    return wrong(params, "is no name of an interface; `ip -br link` lists them");
  std::memcpy(request.ifr_name, params.interface.c_str(), params.interface.size());
  if (ioctl(socket, SIOCGIFINDEX, &request) != 0)
    return wrong(params, "no such interface; plug the adapter in, or name one that `ip -br link` lists");
  const int index = request.ifr_ifindex;
  if (ioctl(socket, SIOCGIFHWADDR, &request) != 0 || request.ifr_hwaddr.sa_family != ARPHRD_CAN)
    return wrong(params, "is no CAN interface; name one that `ip -br link show type can` lists");
  if (ioctl(socket, SIOCGIFFLAGS, &request) != 0 || (request.ifr_flags & IFF_UP) == 0)
    return wrong(params, "is down: " + bring_up(params));
  if ((request.ifr_flags & IFF_RUNNING) == 0) return wrong(params, advice_for_bus_off(params.interface));
  if (params.data_bitrate > 0 && (ioctl(socket, SIOCGIFMTU, &request) != 0 || request.ifr_mtu < int{CANFD_MTU})) {
    return wrong(params, "carries classic CAN only: sudo ip link set " + params.interface + " down && " +
                             bring_up(params) + "; or set data_bitrate = 0");
  }
  return index;
}

bool set(int socket, int option, unsigned int value) {
  return setsockopt(socket, SOL_CAN_RAW, option, &value, sizeof value) == 0;
}

}  // namespace

std::string advice_for_bus_off(const std::string& interface) {
  return "bus-off, the controller saw too many errors; check wires, termination and bit rates, then: sudo ip link "
         "set " +
         interface + " type can restart";
}

SocketCanBus::Carrier look_at_carrier(const std::string& interface) {
  using enum SocketCanBus::Carrier;
  const Descriptor socket(::socket(PF_CAN, SOCK_RAW | SOCK_CLOEXEC, CAN_RAW));
  ifreq request{};
  if (!socket.is_open() || interface.size() >= sizeof request.ifr_name) return unknown;
  std::memcpy(request.ifr_name, interface.c_str(), interface.size());
  if (ioctl(socket.get(), SIOCGIFFLAGS, &request) != 0 || (request.ifr_flags & IFF_UP) == 0) return unknown;
  return (request.ifr_flags & IFF_RUNNING) != 0 ? on : off;
}

Result<Descriptor> open_can_socket(const SocketCanParams& params) {
  Descriptor opened(::socket(PF_CAN, SOCK_RAW | SOCK_NONBLOCK | SOCK_CLOEXEC, CAN_RAW));
  if (!opened.is_open() && (errno == EAFNOSUPPORT || errno == EPROTONOSUPPORT))
    return if_nametoindex(params.interface.c_str()) == 0
               ? wrong(params,
                       "no such interface, and this kernel has no CAN: sudo modprobe can_raw; then plug the "
                       "adapter in, or name one that `ip -br link` lists")
               : wrong(params,
                       "is no CAN interface, and this kernel has no CAN: sudo modprobe can_raw; then name one "
                       "that `ip -br link show type can` lists");
  if (!opened.is_open()) return wrong(params, std::string("no socket: ") + std::strerror(errno));
  const Result<int> index = find_interface(opened.get(), params);
  if (!index) return index.error();
  if (!set(opened.get(), CAN_RAW_ERR_FILTER, CAN_ERR_MASK) || !set(opened.get(), CAN_RAW_RECV_OWN_MSGS, 0) ||
      (params.data_bitrate > 0 && !set(opened.get(), CAN_RAW_FD_FRAMES, 1))) {
    return wrong(params, std::string("the kernel refuses a socket option: ") + std::strerror(errno));
  }
  sockaddr_can address{};
  address.can_family = AF_CAN;
  address.can_ifindex = *index;
  if (bind(opened.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0)
    return wrong(params, std::string("cannot be used: ") + std::strerror(errno) + "; " + bring_up(params));
  return opened;
}

}  // namespace lithe::hal
