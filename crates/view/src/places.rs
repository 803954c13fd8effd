//! Limits on the connections of the live page's server, with reserved places for browsers that hold the token.
//!
//! A connection first sends its header. A client that opens many and sends nothing loses its oldest connection, as a
//! browser sends its header at once. WebSockets stay open for long: those with the token have reserved places.

use std::net::IpAddr;

use tokio::sync::oneshot;

/// Largest number of connections that have not sent their header yet, or get a file.
pub const MAX_WAITING: usize = 64;
/// Largest number of such connections of one address.
const MAX_WAITING_OF_ONE: usize = 16;
/// Largest number of WebSockets with the token. A page has two.
pub const HOLDERS: usize = 32;
/// Largest number of WebSockets without the token, and of those of one address that is not of this machine.
const OTHERS: [usize; 2] = [16, 4];

/// Part of a connection's life that counts against a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Admission {
    /// The header of the next request has not arrived yet, or a file is being sent.
    Waiting,
    /// WebSocket of a browser that has sent the token.
    Holder,
    /// WebSocket of a browser without the token.
    Other,
}

/// One present connection.
struct Place {
    number: u64,
    address: IpAddr,
    admission: Admission,
    /// The task of the connection ends when this is dropped, unless the connection has become a WebSocket.
    _end: oneshot::Sender<()>,
}

/// Present connections of the live page's server, within their limits.
#[derive(Default)]
pub struct Places {
    all: Vec<Place>,
    count: u64,
}

impl Places {
    /// Adds a connection from `address` that sends its header, and returns its number. If there are too many, the
    /// oldest of the same address is ended, or else the oldest of the address that has most. The connection is to be
    /// ended when `end` is dropped.
    pub fn enter(&mut self, address: IpAddr, end: oneshot::Sender<()>) -> u64 {
        let address = address.to_canonical();
        let waiting = |place: &&Place| place.admission == Admission::Waiting;
        let of = |address: IpAddr| self.all.iter().filter(waiting).filter(|place| place.address == address).count();
        let crowd = if of(address) >= MAX_WAITING_OF_ONE {
            Some(address)
        } else if self.all.iter().filter(waiting).count() >= MAX_WAITING {
            self.all.iter().filter(waiting).map(|place| place.address).max_by_key(|address| of(*address))
        } else {
            None
        };
        let leaves = |place: &Place| place.admission == Admission::Waiting && Some(place.address) == crowd;
        if let Some(at) = self.all.iter().position(leaves) {
            self.all.remove(at);
        }
        self.count += 1;
        self.all.push(Place { number: self.count, address, admission: Admission::Waiting, _end: end });
        self.count
    }

    /// Makes the connection a WebSocket of this kind. Returns whether there is a place for it.
    pub fn upgrade(&mut self, number: u64, admission: Admission) -> bool {
        let Some(at) = self.all.iter().position(|place| place.number == number) else { return false };
        let address = self.all[at].address;
        let like = || self.all.iter().filter(|place| place.admission == admission);
        let [others, own] = OTHERS;
        let free = match admission {
            Admission::Waiting => true,
            Admission::Holder => like().count() < HOLDERS,
            Admission::Other => {
                let near = address.is_loopback() || like().filter(|place| place.address == address).count() < own;
                near && like().count() < others
            }
        };
        if free {
            // A WebSocket is never ended for another connection.
            self.all[at].admission = admission;
        }
        free
    }

    /// Removes a connection that has ended.
    pub fn leave(&mut self, number: u64) {
        self.all.retain(|place| place.number != number);
    }

    /// Returns the number of present connections.
    pub fn len(&self) -> usize {
        self.all.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn enter(places: &mut Places, address: IpAddr) -> u64 {
        places.enter(address, oneshot::channel().0)
    }

    fn ip(last: u8) -> IpAddr {
        IpAddr::from([192, 168, 1, last])
    }

    fn number_of(places: &Places, address: IpAddr, admission: Admission) -> usize {
        places.all.iter().filter(|place| (place.address, place.admission) == (address, admission)).count()
    }

    #[test]
    fn who_opens_many_and_says_nothing_loses_the_oldest_of_his_own() {
        let mut places = Places::default();
        let mine = enter(&mut places, ip(1));
        (0..1000).for_each(|_| {
            enter(&mut places, ip(2));
        });
        assert_eq!(number_of(&places, ip(2), Admission::Waiting), MAX_WAITING_OF_ONE);
        for last in 3..100 {
            (0..3).for_each(|_| {
                enter(&mut places, ip(last));
            });
        }
        assert!(places.len() <= MAX_WAITING, "{}", places.len());
        assert!(places.upgrade(mine, Admission::Holder), "one of an address with one stays longest");
    }

    #[test]
    fn those_without_the_token_take_no_place_of_those_with_it() {
        let mut places = Places::default();
        let mut socket = |address: IpAddr, admission| {
            let number = enter(&mut places, address);
            let taken = places.upgrade(number, admission);
            if !taken {
                places.leave(number);
            }
            taken
        };
        let here = IpAddr::from([127, 0, 0, 1]);
        let far = (0..100).filter(|_| socket(ip(2), Admission::Other)).count();
        let near = (0..100).filter(|_| socket(here, Admission::Other)).count();
        assert_eq!((far, near), (OTHERS[1], OTHERS[0] - OTHERS[1]));
        assert_eq!((0..100).filter(|_| socket(ip(2), Admission::Holder)).count(), HOLDERS);
        places.leave(1);
        let number = enter(&mut places, ip(3));
        assert!(places.upgrade(number, Admission::Other), "a place that is left is free");
    }
}
